"""Faults in the reading and layout of parts: files, units, axes, sides, pairings, shapes."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np

from planner.geometry.mesh import TriangleMesh
from tests.proof.planner_faults import Fault, always, change_fields, fields, given, result


def _moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return lambda points: points + np.array([x, y, z])


def _times(x: float = 1.0, y: float = 1.0, z: float = 1.0) -> Any:
    return lambda points: points * np.array([x, y, z])


def _ruled(start: Any = None, end: Any = None) -> Any:
    """Change the ruling ends of the surface that a reader returns with its notes."""

    def change(read_part: tuple[Any, Any]) -> tuple[Any, Any]:
        keep = lambda points: points  # noqa: E731
        return change_fields(read_part[0], start=start or keep, end=end or keep), read_part[1]

    return result(change)


def _mirrored_mesh(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices * np.array([1.0, -1.0, 1.0]), mesh.faces[:, ::-1])


def _mirrored_curve(read_part: tuple[Any, Any]) -> tuple[Any, Any]:
    return [change_fields(curve, points=_times(y=-1.0)) for curve in read_part[0]], read_part[1]


def _larger_curve(read_part: tuple[Any, Any]) -> tuple[Any, Any]:
    return [change_fields(curve, points=lambda p: 1.02 * p) for curve in read_part[0]], read_part[1]


def _fewer_points(read_part: tuple[Any, Any]) -> tuple[Any, Any]:
    """Remove the second point of each curve."""
    return [
        change_fields(curve, points=lambda p: np.delete(p, 1, axis=0)) for curve in read_part[0]
    ], read_part[1]


def _shorter_face(surface: Any) -> Any:
    """A third of it is missing; the wire goes on straight through the block."""
    (u0, u1), v = surface.region
    return dataclasses.replace(surface, region=((u0, u1 - 0.35 * (u1 - u0)), v))


def _shrunk_holes(read_part: tuple[Any, Any]) -> tuple[Any, Any]:
    def smaller(points: Any) -> Any:
        middle = np.array([*points[:, :2].mean(axis=0), 0.0])
        return middle + (points - middle) * np.array([0.96, 0.96, 1.0])

    return [change_fields(r, start=smaller, end=smaller) if r.hole else r for r in read_part[0]], read_part[1]


def _shifted_holes(read_part: tuple[Any, Any]) -> tuple[Any, Any]:
    aside = _moved(x=0.001)
    return [change_fields(r, start=aside, end=aside) if r.hole else r for r in read_part[0]], read_part[1]


def _filled(read_part: tuple[Any, Any]) -> tuple[Any, Any]:
    """Holes are taken for pieces: their outside is where their waste is."""

    def reverse(ruled: Any) -> Any:
        return dataclasses.replace(
            ruled, start=ruled.start[::-1], end=ruled.end[::-1], corner=ruled.corner[::-1], hole=False
        )

    return [reverse(r) if r.hole else r for r in read_part[0]], read_part[1]


def _askew(read_part: tuple[Any, Any]) -> tuple[Any, Any]:
    """Rulings end where others should, by a tenth of the face's length."""
    ruled = read_part[0]
    count = len(ruled.end)
    at = np.linspace(0.0, 1.0, count) ** 1.25 * (count - 1)
    end = np.stack([np.interp(at, np.arange(count), ruled.end[:, k]) for k in range(3)], axis=-1)
    return dataclasses.replace(ruled, end=end), read_part[1]


def _flatter(read_mesh: tuple[Any, ...]) -> tuple[Any, ...]:
    return read_mesh[0] * np.array([1.0, 1.0, 0.9]), *read_mesh[1:]


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
        {"reading.part_surfaces:build_ruled_mesh": _ruled(end=_moved(z=0.002))},
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
            "reading.sheet:build_formed_part": fields(
                formed=lambda f: change_fields(f, mesh=lambda m: change_fields(m, vertices=_moved(x=0.003)))
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
    Fault("naca_half_thickness", "wing", {"geometry.wing:naca_section": result(lambda p: p * [1.0, 0.5])}),
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
    Fault("rhino_unit", "ruled_rhino", {"reading.rhino:_file_unit": result(lambda r: (1.02 * r[0], r[1]))}),
    Fault(
        "rhino_normal_turned",
        "ruled_rhino",
        {"reading.rhino:_selected_face": result(lambda r: (r[0], not r[1]))},
    ),
    Fault("rhino_mirrored", "ruled_rhino", {"reading.rhino:_scale": result(lambda p: p * [1, -1, 1, 1])}),
    Fault("rhino_face_cut_short", "ruled_rhino", {"reading.rhino:_face_region": result(_shorter_face)}),
    # guides and rulings
    Fault("guides_end_lower", "ruled", {"reading.part_ruled:build_ruled": _ruled(end=_moved(z=-0.001))}),
    Fault("guides_paired_askew", "ruled", {"reading.part_ruled:build_ruled": result(_askew)}),
    Fault("guides_as_polygon", "ruled", {"geometry.curves:curve_points": _flat_curves}),
    Fault(
        "surface_inside_out",
        "ruled",
        {"geometry.part_placement:reversed_rulings": lambda old: lambda ruled: ruled},
    ),
    Fault("outline_inside_out", "held", {"geometry.part_placement:facing_outwards": lambda old: _inside_out}),
    Fault("hole_smaller", "plate", {"reading.part:build_plate": result(_shrunk_holes)}),
    Fault("hole_aside", "plate", {"reading.part:build_plate": result(_shifted_holes)}),
    Fault("hole_as_piece", "plate", {"reading.part:build_plate": result(_filled)}),
    Fault(
        "part_laid_lower",
        "ruled",
        {"reading.part:_transform_ruled": fields(start=_moved(z=-0.002), end=_moved(z=-0.002))},
    ),
    # lofts
    Fault("loft_flatter", "elastic", {"geometry.curves:tessellate": result(_flatter)}),
    Fault("loft_coarse", "elastic", {"geometry.curves:grid_counts": always((4, 4))}),
)
