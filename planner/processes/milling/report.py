"""Contribution of milling to the report: the words with which it describes milled faces."""

from typing import Final

from planner.report.charts import FaceWords
from planner.report.plugin_contributions import ReportOfProcess

REPORT: Final = ReportOfProcess(faces={"mill": FaceWords("cutter")})
