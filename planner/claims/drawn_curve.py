"""A curve of a drawing, as a claim states it."""

import dataclasses
from pathlib import Path

Numbers = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class DrawnCurve:
    """A curve as the problem draws it: ``kind`` is ``polyline``, ``bezier``, ``bspline`` (clamped, uniform,
    cubic), by points or control points [mm]; or ``dxf`` or ``rhino``, the one of a ``file``, in its ``unit``
    (none of a Rhino file that states its own), of a ``layer`` or all, at the height ``z_mm`` where that is
    given; of a Rhino file the one that is visible and has the ``name`` and ``colour`` that are given.

    With ``layers`` it stands for all such curves of the file, those of one layer after the other (None: of
    all at once) in the order of the file. Each is run as the first of the pieces that it is joined of is
    drawn, and one that is closed begins with it."""

    kind: str
    points_mm: tuple[Numbers, ...] = ()
    file: Path | None = None
    unit: str = ""
    layer: str | None = None
    z_mm: float | None = None
    name: str | None = None
    colour: str | None = None
    layers: tuple[str | None, ...] = ()
