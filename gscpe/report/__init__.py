# SPDX-License-Identifier: Apache-2.0
"""One HTML page per run: tables, curves, a map seen from above, and pictures of queries."""

from gscpe.report.comparison import ShownResult, show
from gscpe.report.page import write_report
from gscpe.report.settings import ReportSettings
from gscpe.report.top_view import map_from_above

__all__ = ["ReportSettings", "ShownResult", "map_from_above", "show", "write_report"]
