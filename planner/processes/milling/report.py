"""Contribution of milling to the report: words for faces."""

from typing import Final

from planner.report.charts import FaceWords
from planner.report.plugin_contributions import ReportOfProcess

REPORT: Final = ReportOfProcess(faces={"mill": FaceWords("cutter")})
