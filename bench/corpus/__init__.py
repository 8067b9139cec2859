"""A corpus of ordinary jobs, and what becomes of them: ``python -m bench corpus``.

Seeded generators write jobs as users do: a folder with a problem file and its part. About a third has one
fault, put in on purpose and known by the issue codes that name it. Whether a job can be made is argued by its
generator from sizes and formulas, never from what Tandem says. Ranges of the generators only widen.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from typing import Any, Final

from bench.corpus import (
    crowded,
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
from bench.corpus.job import Job, faulty, make

FAMILIES: Final[dict[str, tuple[int, Any, Any]]] = {
    "wing": (45, wings.base, wings.FAULTS),
    "plate": (39, plates.base, plates.FAULTS),
    "wall": (24, walls.base, walls.FAULTS),
    "strips": (24, strips.base, strips.FAULTS),
    "held": (30, held.base, held.FAULTS),
    "elastic": (45, elastic.base, elastic.FAULTS),
    "spif": (30, forming.base("spif"), forming_faults.ONE_ARM),
    "tpif": (18, forming.tpif, forming_faults.TPIF),
    "dsif": (30, forming.base("dsif"), forming_faults.TWO_ARMS),
    "dpif_l": (24, forming.base("dpif_l"), forming_faults.SUPPORTED),
    "dpif_p": (24, forming.base("dpif_p"), forming_faults.BORDER),
    "adsif": (15, forming.adsif, forming_faults.ADSIF),
    "large": (12, forming.large, forming_faults.COMMON),
    "heat": (9, forming.base("heat"), forming_faults.TWO_ARMS),
    "flank": (21, milling.flank, milling.FLANKS),
    "lines": (15, milling.lines, milling.PANELS),
    "engrave": (15, milling.engrave, milling.PATTERNS),
    "gcode": (24, gcode.base, gcode.FAULTS),
    "targets": (24, posed.base, posed.FAULTS),
    "crowded": (18, crowded.base, crowded.FAULTS),
}
"""Number of jobs, generator and faults by family."""


def names(selection: Collection[str] = ()) -> tuple[str, ...]:
    """Return names of all jobs, or of those of selected families and jobs.

    The order is stratified: any first part has jobs of all families, with and without a fault.
    """
    ranked = []
    for order, (name, (count, _, _)) in enumerate(FAMILIES.items()):
        good, bad = ([k for k in range(count) if faulty(k) is wanted] for wanted in (False, True))
        fraction = len(good) / len(bad)
        mixed = sorted(
            [
                *((float(k), i) for k, i in enumerate(good)),
                *((fraction * (k + 0.3), i) for k, i in enumerate(bad)),
            ]
        )
        ranked += [
            ((rank + 0.5) / count, order, f"{name}_{index:02d}") for rank, (_, index) in enumerate(mixed)
        ]
    every = (name for _, _, name in sorted(ranked))
    return tuple(
        name for name in every if not selection or name in selection or name.rsplit("_", 1)[0] in selection
    )


@cache
def find(name: str) -> Job:
    """Return the job with a name.

    Raises:
        KeyError: No job has the name.
    """
    kind, _, number = name.rpartition("_")
    count, base, faults = FAMILIES[kind]
    if not number.isdigit() or int(number) >= count:
        raise KeyError(name)
    return make(kind, int(number), base, faults)


def jobs(selection: Collection[str] = ()) -> tuple[Job, ...]:
    """Return all jobs, or those of selected families and jobs, in the order of `names`."""
    return tuple(find(name) for name in names(selection))
