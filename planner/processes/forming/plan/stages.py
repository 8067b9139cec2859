"""Forming in stages: features that an operation forms, the sheet as other operations leave it, and its holes.

A part may be formed by several operations, each of which names its features. Between them the sheet may be
cut. Displacements of features add up, so a sheet with some features is the flat plus their shares of the
part.

A hole yields under a tool that comes near it, and a hole in sheet that is formed later is moved and
stretched. Neither effect is modelled. Therefore both the tools and everything that an operation forms keep a
stated margin from each curve that was cut, seen along z. A hole outside that margin of everything formed
later stays where it was cut.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planner.geometry.arrays import FloatArray, Mesh, Shape, transform
from planner.geometry.mesh import bisect_triangles
from planner.geometry.mesh_queries import outer_hull
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.problem import FormingStages, SheetHole, Stock
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath
from planner.processes.forming.plan.features.tree import (
    FeatureTree,
    OrderStep,
    custom_order,
    in_place_order,
    virgin_sheet_order,
)
from planner.runtime.memoize import memoized


def own_features(
    name: str, features: tuple[int, ...] | None, stages: FormingStages | None, tree: FeatureTree
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the features that were formed before an operation, and its own, both ascending.

    Args:
        name: Name of the operation.
        features: Features that it names; None for all.
        stages: Operations before and after it on the same sheet.
        tree: Features of the part.

    Raises:
        TandemError: forming.features for numbers that the part does not have, features that are formed twice,
            and features that no operation forms.
    """
    all_features = {feature.id for feature in tree.features}
    stages = stages or FormingStages()
    owner: dict[int, str] = {}
    issues: list[Issue] = []
    for operation, numbers in (*stages.previous, (name, features), *stages.following):
        named = all_features if numbers is None else set(numbers)
        repeated = sorted(named & owner.keys())
        if repeated:
            what = f"{operation}: {_feature_phrase(repeated)} already formed by {owner[repeated[0]]}"
            hint = "name other features, or form all of them in one operation; repeats runs each pass again"
            issues.append(_features_issue(what, hint))
        unknown = sorted(named - all_features)
        if unknown:
            what = (
                f"{operation}: {_feature_phrase(unknown)} not in the part, which has 1 to {len(all_features)}"
            )
            issues.append(_features_issue(what, "list them with: tandem features PART"))
        owner.update(dict.fromkeys(named, operation))
    unformed = sorted(all_features - owner.keys())
    if unformed and not issues:
        what = f"{name}: {_feature_phrase(unformed)} formed by no operation"
        issues.append(
            _features_issue(what, "name them in one of the operations, or remove them from the part")
        )
    if issues:
        raise TandemError(issues)
    previous = {number for _, numbers in stages.previous for number in (numbers or ())}
    return tuple(sorted(previous)), tuple(sorted(all_features if features is None else features))


def _feature_phrase(numbers: Sequence[int]) -> str:
    text = ", ".join(map(str, numbers))
    return f"feature {text} is" if len(numbers) == 1 else f"features {text} are"


def _features_issue(what: str, hint: str) -> Issue:
    return Issue("forming.features", what, field="operations.features", hint=hint)


def formed_sheet(mesh: Mesh, tree: FeatureTree, done: Sequence[int]) -> Mesh:
    """Return the lower face of the sheet once some features are formed.

    Each feature is at the level that it has in the part. A feature inside one that is not formed is as high
    above the flat as it is above that one in the part.

    Args:
        mesh: Lower face of the part.
        tree: Features of the part.
        done: Numbers of the features that are formed.
    """
    if len(done) == len(tree.features):
        return mesh
    height = tree.level + tree.displacement[np.array(done, dtype=np.int64) - 1].sum(axis=0)
    return Mesh(np.column_stack([mesh.vertices[:, :2], height]), mesh.faces)


PROTRUSION_TOLERANCE_M: Final = 0.2 * MM
"""Maximum distance [m] by which the sheet may protrude from the solids that represent it, and from the flat,
unnoticed.
"""


def forming_order(
    tree: FeatureTree,
    virgin: bool,
    given: Sequence[int] | None,
    selected: Sequence[int] | None,
    previous: Sequence[int],
) -> tuple[OrderStep, ...]:
    """Return the order in which an operation forms its features.

    Args:
        tree: Features of the part.
        virgin: Whether its strategy is to form inner features first, on the virgin sheet.
        given: Order that the user states; None for that of the strategy.
        selected: Features to form; None for all.
        previous: Features that were formed before.

    Raises:
        TandemError: forming.order.
    """
    if given is not None:
        return custom_order(tree, given, virgin, selected, previous)
    make_order = virgin_sheet_order if virgin else in_place_order
    return make_order(tree, selected, previous)


def with_states(
    stock: Stock, mesh: Mesh, tree: FeatureTree, order: Sequence[OrderStep], previous: Sequence[int]
) -> Stock:
    """Add solids for what protrudes from the sheet before the part is finished.

    There is one state after each step of the order. What is formed on the virgin sheet stands higher, or
    lower, than in the part until the feature around it takes it along, straight along z, through the solids
    of both states.

    Args:
        stock: Stock with the sheet.
        mesh: Lower face of the part.
        tree: Features of the part.
        order: Steps in the order of forming.
        previous: Features that were formed before.
    """
    sheet = stock.sheet
    if sheet is None:
        return stock
    states = [sorted({*previous, *(step.feature for step in order[: k + 1])}) for k in range(len(order))]
    added = _protruding_solids(mesh, tree, states, float(stock.size[2]), sheet.formed)
    return dataclasses.replace(stock, sheet=dataclasses.replace(sheet, formed=(*sheet.formed, *added)))


@memoized
def _protruding_solids(
    mesh: Mesh, tree: FeatureTree, states: list[list[int]], thickness: float, known: tuple[Shape, ...]
) -> list[Shape]:
    """Hulls, besides those ``known``, of what protrudes from the sheet in each state."""
    solids = list(known)
    for done in states:
        solids += _protruding_pieces(formed_sheet(mesh, tree, done), tree.level, thickness, solids)
    return solids[len(known) :]


def _protruding_pieces(mesh: Mesh, level: float, thickness: float, known: Sequence[Shape]) -> list[Shape]:
    """Hulls of the connected pieces of sheet that protrude from the flat.

    Each piece is off the flat ``level`` [m] and outside the ``known`` solids.
    """
    planes = [_planes(solid) for solid in known]
    rise = np.array([0.0, 0.0, thickness])
    out = []
    for side in (-1.0, 1.0):
        protrudes = side * (mesh.vertices[:, 2] - level) > PROTRUSION_TOLERANCE_M
        faces = mesh.faces[protrudes[mesh.faces].any(axis=1)]
        edges = np.concatenate([faces[:, :2], faces[:, 1:]])
        count = len(mesh.vertices)
        graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
        label = connected_components(graph, directed=False)[1]
        for piece in np.unique(label[faces[:, 0]]) if len(faces) else ():
            vertices = mesh.vertices[np.unique(faces[label[faces[:, 0]] == piece])]
            both_faces = np.concatenate([vertices, vertices + rise])
            beyond = both_faces[
                np.abs(both_faces[:, 2] - level - 0.5 * thickness) > 0.5 * thickness + PROTRUSION_TOLERANCE_M
            ]
            if _is_inside_solids(beyond, planes):
                continue
            hull = outer_hull(both_faces)
            out.append(Shape("mesh", (), np.eye(4), hull.vertices, hull.faces))
    return out


def _is_inside_solids(points: FloatArray, planes: Sequence[tuple[FloatArray, FloatArray]]) -> bool:
    """Whether all ``points`` (P, 3) are in one of the solids.

    They may be outside by at most :data:`PROTRUSION_TOLERANCE_M`.
    """
    outside = points
    for normal, reach in planes:
        if not len(outside):
            return True
        signed_distance = np.full(len(outside), -np.inf if len(normal) else np.inf)
        for n, r in zip(normal, reach, strict=True):
            np.maximum(signed_distance, outside @ n - r, out=signed_distance)
        outside = outside[signed_distance > PROTRUSION_TOLERANCE_M]
    return not len(outside)


def _planes(solid: Shape) -> tuple[FloatArray, FloatArray]:
    """Planes of a convex solid: outward normals (K, 3) and offsets (K,)."""
    if solid.vertices is None or solid.faces is None:
        return np.zeros((0, 3)), np.zeros(0)
    vertices = transform(solid.pose, solid.vertices)
    corners = vertices[solid.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    good = size > 1e-3 * size.max()
    normal = normal[good] / size[good, None]
    reach = np.einsum("kd,kd->k", normal, corners[good, 0])
    inward = np.sign(normal @ vertices.mean(axis=0) - reach) > 0.0
    return np.where(inward[:, None], -normal, normal), np.where(inward, -reach, reach)


MAX_DRAWN_PIECE_M: Final = 0.8 * MM
"""Maximum size [m] of drawn triangles at holes."""
MAX_DRAWN_TRIANGLES: Final = 60_000
"""Maximum number of triangles of a drawn sheet."""


def sheet_exhibit(mesh: Mesh, holes: Sequence[SheetHole], operation_name: str) -> dict[str, Any]:
    """Return the exhibit ``left``: the sheet as an operation leaves it, or nothing if it is too large.

    Args:
        mesh: Lower face of the sheet.
        holes: Curves along which the sheet was cut.
        operation_name: Name of the operation, for the title.
    """
    corners = mesh.vertices[mesh.faces]
    for hole in holes:
        area = shapely.Polygon(hole.ring).buffer(0.0)
        shapely.prepare(area)
        affected = shapely.intersects(area, shapely.polygons(corners[:, :, :2]))
        if not affected.any():  # beyond the part's mesh, in the flat sheet around it
            corners = corners if hole.inside else corners[:0]
            continue
        pieces = bisect_triangles(corners[affected], MAX_DRAWN_PIECE_M, MAX_DRAWN_TRIANGLES)[0]
        middle = pieces.mean(axis=1)
        kept = shapely.contains_xy(area, middle[:, 0], middle[:, 1]) != hole.inside
        corners = np.concatenate([corners[~affected] if hole.inside else corners[:0], pieces[kept]])
    if not 0 < len(corners) <= MAX_DRAWN_TRIANGLES:
        return {}
    vertices, index = np.unique(np.round(corners.reshape(-1, 3), 9), axis=0, return_inverse=True)
    faces = np.asarray(index).reshape(-1, 3)
    return {
        "left": {
            "kind": "left",
            "title": f"The sheet as {operation_name} leaves it",
            "vertices": vertices,
            "faces": faces,
        }
    }


def hole_issues(
    holes: Sequence[SheetHole],
    margin: float,
    paths: Sequence[tuple[FormingPass, FormingToolPath]],
    radii: Sequence[tuple[float, float]],
    slack: float = 0.0,
) -> Iterator[Issue]:
    """Report holes that are too near to what passes form or to their tools (forming.holes).

    Also reports curves if the whole sheet outside of them has dropped.

    Args:
        holes: Curves along which the sheet was cut before.
        margin: Minimum distance [m], seen along z.
        paths: Passes with their tool paths.
        radii: Radii [m] of the forming and the other tool of each pass.
        slack: Deviation [m] that tools may have from their paths.
    """
    for hole in holes:
        ring = shapely.Polygon(hole.ring).buffer(0.0)
        if not hole.inside:
            what = f"the sheet was cut along {hole.name} and drops outside of it, so the clamp holds nothing"
            yield _hole_issue(what, None, margin, "put this operation before the one that cuts it off")
            continue
        feature_distances = [
            (shapely.distance(ring, _plan_region(forming_pass)), forming_pass.name)
            for forming_pass, _ in paths
        ]
        distance, name = min(feature_distances, key=lambda pair: pair[0])
        clearance = max(distance - hole.face_offset, 0.0)
        if clearance < margin:
            what = f"{hole.name}, which was cut before, is {distance / MM:.1f} mm away from what {name} forms"
            what += f", its other edge down to {clearance / MM:.1f} mm" if hole.face_offset > 0.0 else ""
            if distance == 0.0:
                what = f"{hole.name}, which was cut before, lies in what {name} forms, and would be moved"
            hint = "form that feature before the sheet is cut, or move the curve away from it"
            yield _hole_issue(what, clearance, margin, hint)
            continue
        tools = [
            (
                shapely.distance(ring, _plan_curve(centres)) - radius - hole.face_offset - slack,
                forming_pass.name,
            )
            for (forming_pass, path), both in zip(paths, radii, strict=True)
            for centres, radius in zip((path.forming_centre, path.support_centre), both, strict=True)
            if centres is not None
        ]
        clearance, name = min(tools, key=lambda pair: pair[0])
        if clearance < margin:
            proximity = f"comes within {clearance / MM:.1f} mm of" if clearance > 0.0 else "goes over"
            what = f"in {name} a tool {proximity} the edges of {hole.name}, which was cut before"
            hint = "form that feature before the sheet is cut, move the curve away, or use a smaller tool"
            yield _hole_issue(what, max(clearance, 0.0), margin, hint)


def _hole_issue(what: str, value: float | None, margin: float, hint: str) -> Issue:
    what += "" if value is None else f", allowed at least {margin / MM:g} mm (hole_margin_mm)"
    got = None if value is None else float(value) / MM
    limit = None if value is None else margin / MM
    return Issue(
        "forming.holes", what, field="operations.features", value=got, limit=limit, unit="mm", hint=hint
    )


def _plan_region(forming_pass: FormingPass) -> shapely.Geometry:
    return shapely.Polygon(forming_pass.region[:, :2]).buffer(0.0)


def _plan_curve(centres: FloatArray) -> shapely.Geometry:
    return shapely.LineString(centres[:, :2]) if len(centres) > 1 else shapely.Point(centres[0, :2])
