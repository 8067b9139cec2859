"""Rhino files (3DM) for tests, written by rhino3dm, whose values of curves and surfaces are the reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rhino3dm

LOWER = [(0, 0, 0), (60, 25, 0), (140, -20, 10), (200, 5, 0), (300, 0, 5)]
UPPER = [(0, 0, 100), (50, 40, 100), (150, 0, 110), (220, -15, 100), (300, 10, 100)]
UNITS = {"Millimeters": 1.0, "Inches": 25.4, "Meters": 1000.0}


def curve(points: Sequence[Sequence[float]], degree: int = 3, closed: bool = False) -> Any:
    """A curve by control points."""
    return rhino3dm.NurbsCurve.Create(closed, degree, [rhino3dm.Point3d(*point) for point in points])


def ruled_surface(lower: Any = None, upper: Any = None, raised: int = 1) -> Any:
    """A ruled surface between two curves, whose rulings are of degree ``raised``."""
    made = rhino3dm.NurbsSurface.CreateRuledSurface(lower or curve(LOWER), upper or curve(UPPER))
    if raised > 1:
        made.IncreaseDegreeV(raised)
    return made


def free_surface(size: float = 200.0, rise: float = 30.0) -> Any:
    """A face that bends both ways, of degree 3 and 2, with weights."""
    made = rhino3dm.NurbsSurface.Create(3, True, 4, 3, 5, 4)
    for u in range(5):
        for v in range(4):
            z = rise * np.sin(0.7 * u) * np.cos(0.9 * v)
            weight = 1.0 + 0.3 * ((u + v) % 2)
            made.Points[u, v] = rhino3dm.Point4d(
                weight * size * u / 4.0, weight * size * v / 3.0, weight * float(z), weight
            )
    for knots, count in ((made.KnotsU, 2), (made.KnotsV, 2)):
        knots.CreateUniformKnots(1.0 / count)
    return made


class Model:
    """A file in the making."""

    def __init__(self, unit: str = "Millimeters") -> None:
        self.file = rhino3dm.File3dm()
        self.file.Settings.ModelUnitSystem = getattr(rhino3dm.UnitSystem, unit)
        self.layers: dict[str, int] = {}

    def layer(self, name: str, parent: str = "", visible: bool = True, colour: Any = (0, 0, 0, 255)) -> None:
        """Add a layer, in another one."""
        made = rhino3dm.Layer()
        made.Name, made.Visible, made.Color = name, visible, colour
        if parent:
            made.ParentLayerId = self.file.Layers[self.layers[parent]].Id
        self.layers[name] = self.file.Layers.Add(made)

    def add(self, geometry: Any, layer: str = "", name: str = "", **more: Any) -> None:
        """Add an object to a layer."""
        own = rhino3dm.ObjectAttributes()
        own.Name = name
        if layer:
            own.LayerIndex = self.layers[layer]
        for key, value in more.items():
            setattr(own, key, value)
        if isinstance(geometry, rhino3dm.NurbsSurface):
            geometry = rhino3dm.Brep.CreateFromSurface(geometry)
        kinds = {"Brep": "AddBrep", "Mesh": "AddMesh", "Extrusion": "AddExtrusion", "Point": "AddPoint"}
        add = getattr(self.file.Objects, kinds.get(type(geometry).__name__, "AddCurve"))
        add(geometry, own)

    def write(self, path: Path) -> Path:
        """Write it."""
        assert self.file.Write(str(path), 7)
        return path


def at(surface: Any, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Points (N, 3) of a surface by rhino3dm."""
    return np.array([(p.X, p.Y, p.Z) for p in (surface.PointAt(a, b) for a, b in zip(u, v, strict=True))])


def sample_curve(curve: Any, count: int) -> np.ndarray:
    """Points (N, 3) of a curve by rhino3dm."""
    t = np.linspace(curve.Domain.T0, curve.Domain.T1, count)
    return np.array([(p.X, p.Y, p.Z) for p in (curve.PointAt(x) for x in t)])
