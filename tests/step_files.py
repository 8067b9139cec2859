"""STEP and IGES files for tests, written by Open CASCADE, whose values of surfaces are the reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.collections import Array1_double, Array1_int, Array2_gp_Pnt
from OCP.Geom import Geom_BSplineSurface
from OCP.gp import gp_Pnt
from OCP.IGESControl import IGESControl_Writer
from OCP.Interface import Interface_Static
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer

UNITS = {"MM": 1.0, "M": 1000.0, "INCH": 25.4}


def bspline(control: Any, degree: tuple[int, int]) -> Any:
    """A clamped B-spline surface by control points (C, D, 3) [mm]."""
    control = np.asarray(control, dtype=float)
    poles = Array2_gp_Pnt(1, control.shape[0], 1, control.shape[1])
    for i in range(control.shape[0]):
        for j in range(control.shape[1]):
            poles.SetValue(i + 1, j + 1, gp_Pnt(*map(float, control[i, j])))
    knots, counts = [], []
    for count, p in zip(control.shape, degree, strict=False):
        inner = count - p
        own, many = Array1_double(1, inner + 1), Array1_int(1, inner + 1)
        for k in range(inner + 1):
            own.SetValue(k + 1, float(k))
            many.SetValue(k + 1, p + 1 if k in (0, inner) else 1)
        knots.append(own)
        counts.append(many)
    return Geom_BSplineSurface(poles, *knots, *counts, *degree, False, False)


def face(surface: Any, *region: float) -> Any:
    """The face of a surface, whole or between u0, u1, v0, v1."""
    made = (
        BRepBuilderAPI_MakeFace(surface, *region, 1e-6) if region else BRepBuilderAPI_MakeFace(surface, 1e-6)
    )
    return made.Face()


def write(path: Path, shapes: Sequence[Any], unit: str = "MM") -> Path:
    """A file of these shapes, its lengths in ``unit``."""
    if path.suffix in (".igs", ".iges"):
        iges = IGESControl_Writer({"MM": "MM", "M": "M", "INCH": "IN"}[unit], 1)
        for shape in shapes:
            iges.AddShape(shape)
        iges.ComputeModel()
        assert iges.Write(str(path))
        return path
    step = STEPControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", unit)
    for shape in shapes:
        step.Transfer(shape, STEPControl_AsIs)
    step.Write(str(path))
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    return path
