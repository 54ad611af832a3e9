# SPDX-License-Identifier: Apache-2.0
"""The main job on real photos with a known answer, without a download: ``gscpe demo``."""

from gscpe.demo.demo import DemoReport, run_demo
from gscpe.demo.motorcycle import Motorcycle, load_motorcycle

__all__ = ["DemoReport", "Motorcycle", "load_motorcycle", "run_demo"]
