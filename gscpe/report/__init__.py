# SPDX-License-Identifier: Apache-2.0
"""One HTML page per run: tables, curves, a map seen from above, and pictures of queries."""

from gscpe.report.comparison import ShownResult, show
from gscpe.report.map_above import map_from_above
from gscpe.report.page import write_report
from gscpe.report.settings import ReportSettings

__all__ = ["ReportSettings", "ShownResult", "map_from_above", "show", "write_report"]
