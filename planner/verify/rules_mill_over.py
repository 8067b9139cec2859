"""Rules on cutters that pass over faces with their ends: the issues that make part of
``verify.mill_path``."""

from __future__ import annotations

import numpy as np

from planner.issues import Issue
from planner.verify.context import Context, mm
from planner.verify.findings import at_sample
from planner.verify.mill_over import OverFace
from planner.verify.mill_track import Milling

CODE = "verify.mill_path"
SHOWN = 50
STEP = 1e-3
"""Way between places [m] at which a cutter is held against its face."""


def over(context: Context, milling: Milling) -> tuple[list[Issue], float, str]:
    """Issues of all passes over faces, and the worst of what is allowed, with its segment."""
    issues: list[Issue] = []
    worst, where = 0.0, ""
    for index, claim in milling.over:
        face = OverFace(claim)
        for segment in claim.segments:
            labels = (segment.key,)
            if not len(milling.track(index, claim.arm, labels).rows):
                issues.append(Issue(CODE, f"{segment} is not milled", field=str(segment)))
                continue
            tip, axis, rows = milling.spaced(index, claim.arm, labels, STEP)
            for asked, off in face.off(tip, axis).items():
                if off.max() > worst:
                    worst, where = float(off.max()), str(segment)
                bad = np.flatnonzero(off > 1.0)
                for i in bad[:: max(1, len(bad) // SHOWN)]:
                    what = f"in {segment} the cutter is {asked}, {off[i]:.2f} times as far as allowed, "
                    what += f"{mm(claim.tolerance):g} mm"
                    issues.append(at_sample(CODE, what, context.motion, claim.arm, int(rows[i])))
    return issues, worst, where
