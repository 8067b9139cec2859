"""Faults in how parts are read and laid out: files, units, axes, sides, pairings, shapes."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np

from planner.geometry.mesh import TriangleMesh
from tests.proof.planner_faults import Fault, always, fields, given, of, result


def _moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return lambda points: points + np.array([x, y, z])


def _times(x: float = 1.0, y: float = 1.0, z: float = 1.0) -> Any:
    return lambda points: points * np.array([x, y, z])


def _ruled(start: Any = None, end: Any = None) -> Any:
    """A change of the rulings' ends of the surface that a reader gives back with its notes."""

    def change(found: tuple[Any, Any]) -> tuple[Any, Any]:
        keep = lambda points: points  # noqa: E731
        return of(found[0], start=start or keep, end=end or keep), found[1]

    return result(change)


def _mirrored_mesh(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices * np.array([1.0, -1.0, 1.0]), mesh.faces[:, ::-1])


def _mirrored_curve(found: tuple[Any, Any]) -> tuple[Any, Any]:
    return [of(curve, points=_times(y=-1.0)) for curve in found[0]], found[1]


def _larger_curve(found: tuple[Any, Any]) -> tuple[Any, Any]:
    return [of(curve, points=lambda p: 1.02 * p) for curve in found[0]], found[1]


def _fewer_points(found: tuple[Any, Any]) -> tuple[Any, Any]:
    """Of each curve the second point is left out."""
    return [of(curve, points=lambda p: np.delete(p, 1, axis=0)) for curve in found[0]], found[1]


def _shorter_face(surface: Any) -> Any:
    """A third of it is missing; the wire goes on straight through the block."""
    (u0, u1), v = surface.region
    return dataclasses.replace(surface, region=((u0, u1 - 0.35 * (u1 - u0)), v))


def _shrunk_holes(found: tuple[Any, Any]) -> tuple[Any, Any]:
    def smaller(points: Any) -> Any:
        middle = np.array([*points[:, :2].mean(axis=0), 0.0])
        return middle + (points - middle) * np.array([0.96, 0.96, 1.0])

    return [of(r, start=smaller, end=smaller) if r.hole else r for r in found[0]], found[1]


def _holes_beside(found: tuple[Any, Any]) -> tuple[Any, Any]:
    aside = _moved(x=0.001)
    return [of(r, start=aside, end=aside) if r.hole else r for r in found[0]], found[1]


def _filled(found: tuple[Any, Any]) -> tuple[Any, Any]:
    """Holes are taken for pieces: their outside is where their waste is."""

    def turned(ruled: Any) -> Any:
        return dataclasses.replace(
            ruled, start=ruled.start[::-1], end=ruled.end[::-1], corner=ruled.corner[::-1], hole=False
        )

    return [turned(r) if r.hole else r for r in found[0]], found[1]


def _askew(found: tuple[Any, Any]) -> tuple[Any, Any]:
    """Rulings end where others should, by a tenth of the face's length."""
    ruled = found[0]
    count = len(ruled.end)
    at = np.linspace(0.0, 1.0, count) ** 1.25 * (count - 1)
    end = np.stack([np.interp(at, np.arange(count), ruled.end[:, k]) for k in range(3)], axis=-1)
    return dataclasses.replace(ruled, end=end), found[1]


def _flatter(made: tuple[Any, ...]) -> tuple[Any, ...]:
    return made[0] * np.array([1.0, 1.0, 0.9]), *made[1:]


def _inside_out(ruled: Any) -> Any:
    order = np.arange(len(ruled.start))[::-1]
    return dataclasses.replace(
        ruled, start=ruled.start[order], end=ruled.end[order], corner=ruled.corner[order]
    )


def _flat_curves(old: Any) -> Any:
    """Curves as the polygons of their control points."""

    def points(kind: str, control: Any, t: Any) -> Any:
        at = np.linspace(0.0, 1.0, len(control))
        rows = [np.interp(t, at, control[..., k]) for k in range(control.shape[-1])]
        return np.stack(rows, axis=-1)

    return points


FAULTS: Final = (
    # files of meshes
    Fault("mesh_unit", "ruled_mesh", {"geometry.mesh_files:read_mesh": given(1, lambda unit: 1.02 * unit)}),
    Fault("mesh_mirrored", "ruled_mesh", {"geometry.mesh_files:read_mesh": result(_mirrored_mesh)}),
    Fault("mesh_moved", "ruled_mesh", {"geometry.mesh_files:read_mesh": fields(vertices=_moved(z=0.002))}),
    Fault(
        "mesh_rulings_shifted",
        "ruled_mesh",
        {"reading.part_surfaces:build_mesh": _ruled(end=_moved(z=0.002))},
    ),
    Fault("sheet_mesh_unit", "spif", {"geometry.mesh_files:read_mesh": given(1, lambda unit: 1.05 * unit)}),
    Fault("sheet_mesh_deeper", "spif", {"geometry.mesh_files:read_mesh": fields(vertices=_times(z=1.2))}),
    Fault("sheet_mesh_shallower", "spif", {"geometry.mesh_files:read_mesh": fields(vertices=_times(z=0.9))}),
    Fault("sheet_mesh_narrower", "oval", {"geometry.mesh_files:read_mesh": fields(vertices=_times(x=0.95))}),
    Fault(
        "sheet_mesh_axes_swapped",
        "oval",
        {
            "geometry.mesh_files:read_mesh": fields(
                vertices=lambda v: v[:, [1, 0, 2]], faces=lambda f: f[:, ::-1]
            )
        },
    ),
    Fault(
        "sheet_mesh_aside",
        "spif",
        {
            "reading.sheet:build": fields(
                formed=lambda f: of(f, mesh=lambda m: of(m, vertices=_moved(x=0.003)))
            )
        },
    ),
    # airfoils and wings
    Fault(
        "airfoil_upside_down",
        "wing",
        {"geometry.wing:read_airfoil": result(lambda r: (r[0][::-1] * [1.0, -1.0], r[1]))},
    ),
    Fault(
        "airfoil_thinner", "wing", {"geometry.wing:read_airfoil": result(lambda r: (r[0] * [1.0, 0.9], r[1]))}
    ),
    Fault("naca_half_thickness", "wing", {"geometry.wing:naca": result(lambda p: p * [1.0, 0.5])}),
    Fault("wing_twist_up", "wing", {"geometry.wing:_placed": given(3, lambda twist: -twist)}),
    Fault(
        "wing_sections_swapped",
        "wing",
        {"geometry.wing:wing_surface": given(0, lambda p: dataclasses.replace(p, root=p.tip, tip=p.root))},
    ),
    Fault(
        "wing_trailing_edge_thick", "wing", {"geometry.wing:thickened": given(1, lambda least: 2.5 * least)}
    ),
    # drawings
    Fault("dxf_unit", "ruled_file", {"reading.part_ruled:read_dxf": result(_larger_curve)}),
    Fault("dxf_mirrored", "ruled_file", {"reading.part_ruled:read_dxf": result(_mirrored_curve)}),
    Fault("dxf_points_lost", "ruled_file", {"reading.part_ruled:read_dxf": result(_fewer_points)}),
    # Rhino files
    Fault("rhino_unit", "ruled_rhino", {"reading.rhino:_unit": result(lambda r: (1.02 * r[0], r[1]))}),
    Fault("rhino_normal_turned", "ruled_rhino", {"reading.rhino:_face": result(lambda r: (r[0], not r[1]))}),
    Fault("rhino_mirrored", "ruled_rhino", {"reading.rhino:_scaled": result(lambda p: p * [1, -1, 1, 1])}),
    Fault("rhino_face_cut_short", "ruled_rhino", {"reading.rhino:_region": result(_shorter_face)}),
    # guides and rulings
    Fault("guides_end_lower", "ruled", {"reading.part_ruled:build_ruled": _ruled(end=_moved(z=-0.001))}),
    Fault("guides_paired_askew", "ruled", {"reading.part_ruled:build_ruled": result(_askew)}),
    Fault("guides_as_polygon", "ruled", {"geometry.curves:curve_points": _flat_curves}),
    Fault("surface_inside_out", "ruled", {"geometry.placing:backwards": lambda old: lambda ruled: ruled}),
    Fault("outline_inside_out", "held", {"geometry.placing:outwards": lambda old: _inside_out}),
    Fault("hole_smaller", "plate", {"reading.part:build_plate": result(_shrunk_holes)}),
    Fault("hole_aside", "plate", {"reading.part:build_plate": result(_holes_beside)}),
    Fault("hole_as_piece", "plate", {"reading.part:build_plate": result(_filled)}),
    Fault(
        "part_laid_lower",
        "ruled",
        {"reading.part:_ruled": fields(start=_moved(z=-0.002), end=_moved(z=-0.002))},
    ),
    # lofts
    Fault("loft_flatter", "elastic", {"geometry.curves:tessellate": result(_flatter)}),
    Fault("loft_coarse", "elastic", {"geometry.curves:grid_counts": always((4, 4))}),
)
