"""The contribution of forming to the report: the gap between two tools, and words for faces."""

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.units import MM
from planner.plans import Plan
from planner.report import markup
from planner.report.charts import ChartLine, FaceWords
from planner.report.plugin_contributions import ProcessMotion, ReportOfProcess, TimeChart


def _gap_chart(_: Plan, series: Mapping[str, Any]) -> ProcessMotion:
    """Return the chart of the gap between the tools.

    The gaps of all claims follow one another in time. A NaN after each of them interrupts the lines.

    Args:
        _: Plan; not used.
        series: Series ``gap/<n>/time`` [s] and ``got``, ``low``, ``high`` [m] of the n-th claim, each (G,).
    """
    matches = (re.fullmatch(r"gap/(\d+)/time", name) for name in series)
    gaps = [
        np.stack(
            [np.append(series[f"gap/{n}/{quantity}"], np.nan) for quantity in ("time", "got", "low", "high")]
        )
        for n in sorted(int(match.group(1)) for match in matches if match)
        if len(series[f"gap/{n}/time"])
    ]
    if not gaps:
        return ProcessMotion()
    time, actual, low, high = np.concatenate(gaps, axis=1)
    lines = (
        ChartLine("gap", time, actual / MM, 0),
        ChartLine("maximum", time, high / MM, 1, True),
        ChartLine("minimum", time, low / MM, 3, True),
    )
    margin = np.minimum(actual - low, high - actual) / MM
    note = f"smallest margin to a limit: {markup.fixed_decimals(float(np.nanmin(margin)), 3)} mm"
    return ProcessMotion(distances=(TimeChart("Gap between the tools", lines, "mm", note),))


REPORT: Final = ReportOfProcess(
    motion=_gap_chart, faces={"form": FaceWords("ball", "pressed too deep", "not formed deep enough")}
)
