"""A curve of a drawing, in the form in which claims state it."""

import dataclasses
from pathlib import Path

Numbers = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class DrawnCurve:
    """A curve that the problem states by points or by a file, or all curves on some layers of a file.

    With ``layers`` it stands for all curves of the file on these layers, one layer after the other, in the
    order of the file. A curve that consists of several pieces runs in the direction of the first one, and a
    closed curve starts with it.

    Attributes:
        kind: ``polyline``, ``bezier`` or ``bspline`` (clamped, uniform, cubic), stated by points; ``dxf`` or
            ``rhino``, stated by a file.
        points_mm: Points of a polyline, or control points [mm].
        file: File with the curve.
        unit: Unit of the file, empty if a Rhino file states its own.
        layer: Layer of the curve, None for all layers.
        z_mm: Height of the curve [mm], None for that of the file.
        name: Name of the visible curve in a Rhino file, if given.
        colour: Colour of the visible curve in a Rhino file, if given.
        layers: Layers of the curves, None for all layers together.
    """

    kind: str
    points_mm: tuple[Numbers, ...] = ()
    file: Path | None = None
    unit: str = ""
    layer: str | None = None
    z_mm: float | None = None
    name: str | None = None
    colour: str | None = None
    layers: tuple[str | None, ...] = ()
