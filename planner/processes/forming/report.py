"""What forming adds to the report: the gap between two tools, words for faces."""

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.units import MM
from planner.plans import Plan
from planner.report import markup
from planner.report.charts import FaceWords, Line
from planner.report.contribution import ProcessMotion, ReportOfProcess, TimeChart


def _motion(_: Plan, series: Mapping[str, Any]) -> ProcessMotion:
    """A chart of the series of gap n: ``gap/<n>/time``, ``got``, ``low``, ``high`` [m], each (G,). All gaps
    follow one another. Lines end between two of them."""
    found = (re.fullmatch(r"gap/(\d+)/time", name) for name in series)
    rows = [
        np.stack([np.append(series[f"gap/{n}/{what}"], np.nan) for what in ("time", "got", "low", "high")])
        for n in sorted(int(match.group(1)) for match in found if match)
        if len(series[f"gap/{n}/time"])
    ]
    if not rows:
        return ProcessMotion()
    time, got, low, high = np.concatenate(rows, axis=1)
    lines = (
        Line("gap", time, got / MM, 0),
        Line("most", time, high / MM, 1, True),
        Line("least", time, low / MM, 3, True),
    )
    room = np.minimum(got - low, high - got) / MM
    note = f"nearest to what is not allowed: {markup.fixed(float(np.nanmin(room)), 3)} mm"
    return ProcessMotion(distances=(TimeChart("Gap between the tools", lines, "mm", note),))


REPORT: Final = ReportOfProcess(
    motion=_motion, faces={"form": FaceWords("ball", "pressed too far", "not pressed so far")}
)
