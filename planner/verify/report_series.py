"""Arrays over the replayed motion, by name, for the report."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.cell.clearance import LeastClearance
from planner.geometry.vectors import lengths
from planner.verify.context import Context
from planner.verify.forming_state import Forming
from planner.verify.motion import differences
from planner.verify.rules_wire import feed_speed
from planner.verify.wire import Wire

IntArray = NDArray[np.int64]
_MOST = 6000


def series(
    context: Context,
    wires: tuple[Wire, ...],
    forming: Forming | None,
    looks: IntArray,
    clearance: LeastClearance | None,
    wire_clearance: list[NDArray[np.float64]],
) -> dict[str, Any]:
    """Names and units as they are: SI, per arm ``joints/<arm>`` (S, 6), ``speed/<arm>``,
    ``acceleration/<arm>``, ``tcp_speed/<arm>``.

    The motion is thinned to a few thousand samples, extremes of speeds and accelerations kept within each.
    ``clearance/...`` over the looks of the clearance rule, ``wire/<n>/...`` over the stations of each wire;
    straight ones have no stability, curvature and clearance of their own. ``gap/<n>/...`` over what two tools
    form: what they leave between them and what is wanted.
    """
    motion = context.motion
    stride = max(1, len(motion.time) // _MOST)
    rows = np.arange(0, len(motion.time), stride)
    out: dict[str, Any] = {"time": motion.time[rows], "label": motion.labels(rows)}
    for arm, q in motion.q.items():
        out[f"joints/{arm}"] = q[rows]
        # one axis at a time: a long motion has so many samples that a copy of all is felt
        for name, order in (("speed", 1), ("acceleration", 2)):
            axes = [_peaks(differences(motion.time, q[:, axis, None], order), rows) for axis in range(6)]
            out[f"{name}/{arm}"] = np.concatenate(axes, axis=1)
        way = lengths(np.diff(motion.tcp[arm].place, axis=0, prepend=motion.tcp[arm].place[:1]))
        way /= np.maximum(np.diff(motion.time, prepend=motion.time[:1] - 1.0), 1e-6)
        out[f"tcp_speed/{arm}"] = _peaks(way[:, None], rows)[:, 0]
    out["targets/time"] = motion.time[motion.node_sample]
    out["targets/label"] = motion.node_label
    if clearance is not None:
        out["clearance/time"] = motion.time[looks]
        out["clearance/distance"] = clearance.distance
        out["clearance/pair"] = np.array([" - ".join(pair) for pair in clearance.pair])
    for n, wire in enumerate(wires, 1):
        if wire.fault:
            continue
        out |= {
            f"wire/{n}/time": motion.time[wire.sample],
            f"wire/{n}/label": wire.labels,
            f"wire/{n}/points": wire.points,
            f"wire/{n}/depth": wire.depth,
            f"wire/{n}/feed": feed_speed(context, wire),
        }
        if wire.path is None:
            continue
        out |= {
            f"wire/{n}/stability": wire.path.min_eig,
            f"wire/{n}/curvature": np.linalg.norm(wire.path.curvature, axis=2).max(axis=1),
        }
        if len(wire_clearance) >= n:
            out[f"wire/{n}/clearance"] = wire_clearance[n - 1]
    for n, gap in enumerate(forming.opened if forming is not None else (), 1):
        some = np.unique(np.linspace(0, max(len(gap.knots) - 1, 0), _MOST).astype(np.int64))[: len(gap.knots)]
        out |= {
            f"gap/{n}/time": motion.time[gap.track.rows[gap.knots[some]]],
            f"gap/{n}/got": gap.got[some],
            f"gap/{n}/low": gap.low[some] - gap.claim.tolerance,
            f"gap/{n}/high": gap.high[some] + gap.claim.tolerance,
        }
    return out


def _peaks(values: NDArray[np.float64], rows: IntArray) -> NDArray[np.float64]:
    """Value of largest size within each stretch between rows."""
    if len(rows) == len(values):
        return values
    high = np.maximum.reduceat(values, rows, axis=0)
    low = np.minimum.reduceat(values, rows, axis=0)
    return np.asarray(np.where(high > -low, high, low))
