"""A corpus of ordinary jobs, and what becomes of them: ``python -m bench corpus``.

Seeded generators write jobs as users do: a folder with a problem file and its part. About a third has one
fault, put in on purpose and known by the issue codes that name it. Whether a job can be made is argued by its
generator from sizes and formulas, never from what Tandem says. Ranges of the generators only widen.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any, Final

from bench.corpus import (
    elastic,
    forming,
    forming_faults,
    gcode,
    held,
    milling,
    plates,
    posed,
    strips,
    walls,
    wings,
)
from bench.corpus.job import Job, family

FAMILIES: Final[dict[str, tuple[int, Any, Any]]] = {
    "wing": (45, wings.base, wings.FAULTS),
    "plate": (39, plates.base, plates.FAULTS),
    "wall": (24, walls.base, walls.FAULTS),
    "strips": (24, strips.base, strips.FAULTS),
    "held": (30, held.base, held.FAULTS),
    "elastic": (42, elastic.base, elastic.FAULTS),
    "spif": (30, forming.base("spif"), forming_faults.ONE_ARM),
    "tpif": (18, forming.tpif, forming_faults.TPIF),
    "dsif": (30, forming.base("dsif"), forming_faults.TWO_ARMS),
    "dpif_l": (24, forming.base("dpif_l"), forming_faults.SUPPORTED),
    "dpif_p": (24, forming.base("dpif_p"), forming_faults.BORDER),
    "adsif": (15, forming.adsif, forming_faults.ADSIF),
    "heat": (9, forming.base("heat"), forming_faults.TWO_ARMS),
    "flank": (21, milling.flank, milling.FLANKS),
    "lines": (15, milling.lines, milling.PANELS),
    "engrave": (15, milling.engrave, milling.PATTERNS),
    "gcode": (24, gcode.base, gcode.FAULTS),
    "targets": (24, posed.base, posed.FAULTS),
}
"""Number of jobs, generator and faults by family."""


@cache
def of_family(name: str) -> tuple[Job, ...]:
    """All jobs of a family."""
    count, base, faults = FAMILIES[name]
    return family(name, count, base, faults)


def jobs() -> tuple[Job, ...]:
    """All jobs, stratified: any first part of them has jobs of all families, with and without a fault."""
    ranked = [
        ((rank + 0.5) / len(of_family(name)), order, job)
        for order, name in enumerate(FAMILIES)
        for rank, job in enumerate(_mixed(of_family(name)))
    ]
    return tuple(job for _, _, job in sorted(ranked, key=lambda row: row[:2]))


def _mixed(members: Iterable[Job]) -> list[Job]:
    """Jobs of a family, one with a fault after each that can be made, as long as there are any."""
    rows = list(members)
    good, bad = ([job for job in rows if job.feasible is wanted] for wanted in (True, False))
    share = len(good) / max(len(bad), 1)
    return sorted(rows, key=lambda j: good.index(j) if j.feasible else (bad.index(j) + 0.3) * share)


def find(name: str) -> Job:
    """The job of a name. Raises ``KeyError`` where there is none."""
    for job in of_family(name.rsplit("_", 1)[0]) if name.rsplit("_", 1)[0] in FAMILIES else ():
        if job.name == name:
            return job
    raise KeyError(name)
