# SPDX-License-Identifier: Apache-2.0
"""Poses over HTTP: a server whose worker processes hold the maps, and a client for it."""

from gscpe.service.client import Client

__all__ = ["Client"]
