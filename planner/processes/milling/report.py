"""What milling adds to the report: words for faces."""

from typing import Final

from planner.report.charts import FaceWords
from planner.report.contribution import ReportOfProcess

REPORT: Final = ReportOfProcess(faces={"mill": FaceWords("cutter")})
