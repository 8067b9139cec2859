"""Forming in stages: features that an operation forms, the sheet as other operations leave it, and its holes.

A part may be formed by several operations, each of which names its features. Between them the sheet may be
cut. Displacements of features add up, so the height of a sheet with some features is that of the flat plus
the displacements by these features.

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
            message = f"{operation}: {_feature_phrase(repeated)} already formed by {owner[repeated[0]]}"
            hint = "name other features, or form all of them in one operation; repeats runs each pass again"
            issues.append(_features_issue(message, hint))
        unknown = sorted(named - all_features)
        if unknown:
            message = (
                f"{operation}: {_feature_phrase(unknown)} not in the part, which has 1 to {len(all_features)}"
            )
            issues.append(_features_issue(message, "list them with: tandem features PART"))
        owner.update(dict.fromkeys(named, operation))
    unformed = sorted(all_features - owner.keys())
    if unformed and not issues:
        message = f"{name}: {_feature_phrase(unformed)} formed by no operation"
        issues.append(
            _features_issue(message, "name them in one of the operations, or remove them from the part")
        )
    if issues:
        raise TandemError(issues)
    previous = {number for _, numbers in stages.previous for number in (numbers or ())}
    return tuple(sorted(previous)), tuple(sorted(all_features if features is None else features))


def _feature_phrase(numbers: Sequence[int]) -> str:
    """Return the subject and verb of a message, such as "features 2, 3 are"."""
    text = ", ".join(map(str, numbers))
    return f"feature {text} is" if len(numbers) == 1 else f"features {text} are"


def _features_issue(message: str, hint: str) -> Issue:
    return Issue("forming.features", message, field="operations.features", hint=hint)


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
    """Return the stock with solids added for sheet that protrudes before the part is finished.

    The arms keep clear of these solids. The state of the sheet after each step of the order is considered. A
    feature that is formed on the virgin sheet stands higher or lower than in the part, until the feature
    around it moves it along z to its final place. The solids of both states together contain this motion.

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
    """Return convex hulls of what protrudes from the sheet in each state and is not in a ``known`` solid."""
    solids = list(known)
    for done in states:
        solids += _protruding_pieces(formed_sheet(mesh, tree, done), tree.level, thickness, solids)
    return solids[len(known) :]


def _protruding_pieces(mesh: Mesh, level: float, thickness: float, existing: Sequence[Shape]) -> list[Shape]:
    """Return the convex hulls of the connected pieces of sheet that protrude from the flat.

    Pieces above and below the flat sheet at ``level`` [m] are separate. Pieces inside the ``existing`` solids
    are left out.
    """
    planes = [_planes(solid) for solid in existing]
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
    """Return whether each of the ``points`` (P, 3) is in at least one of the solids.

    A point may be outside by at most :data:`PROTRUSION_TOLERANCE_M`.
    """
    outside = points
    for normal, offset in planes:
        if not len(outside):
            return True
        signed_distance = np.full(len(outside), -np.inf if len(normal) else np.inf)
        for facet_normal, facet_offset in zip(normal, offset, strict=True):
            np.maximum(signed_distance, outside @ facet_normal - facet_offset, out=signed_distance)
        outside = outside[signed_distance > PROTRUSION_TOLERANCE_M]
    return not len(outside)


def _planes(solid: Shape) -> tuple[FloatArray, FloatArray]:
    """Return the planes of a convex solid: outward normals (K, 3) and offsets (K,) [m] from the origin."""
    if solid.vertices is None or solid.faces is None:
        return np.zeros((0, 3)), np.zeros(0)
    vertices = transform(solid.pose, solid.vertices)
    corners = vertices[solid.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    is_valid = length > 1e-3 * length.max()  # the normals of slivers are inaccurate
    normal = normal[is_valid] / length[is_valid, None]
    offset = np.einsum("kd,kd->k", normal, corners[is_valid, 0])
    is_inward = np.sign(normal @ vertices.mean(axis=0) - offset) > 0.0
    return np.where(is_inward[:, None], -normal, normal), np.where(is_inward, -offset, offset)


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
        centroid = pieces.mean(axis=1)
        kept = shapely.contains_xy(area, centroid[:, 0], centroid[:, 1]) != hole.inside
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

    A curve along which the sheet was cut off its clamp is reported, too. Each hole gets at most one issue.

    Args:
        holes: Curves along which the sheet was cut before.
        margin: Minimum distance [m], seen along z.
        paths: Passes with their tool paths.
        radii: Radii [m] of the forming and the other tool of each pass.
        slack: Deviation [m] in plan that tools may have from their paths.
    """
    for hole in holes:
        ring = shapely.Polygon(hole.ring).buffer(0.0)
        if not hole.inside:
            message = (
                f"the sheet was cut along {hole.name} and drops outside of it, so the clamp holds nothing"
            )
            yield _hole_issue(message, None, margin, "put this operation before the one that cuts it off")
            continue
        feature_distances = [
            (shapely.distance(ring, _plan_region(forming_pass)), forming_pass.name)
            for forming_pass, _ in paths
        ]
        distance, name = min(feature_distances, key=lambda pair: pair[0])
        clearance = max(distance - hole.face_offset, 0.0)
        if clearance < margin:
            message = (
                f"{hole.name}, which was cut before, is {distance / MM:.1f} mm away from what {name} forms"
            )
            message += f", its other edge down to {clearance / MM:.1f} mm" if hole.face_offset > 0.0 else ""
            if distance == 0.0:
                message = f"{hole.name}, which was cut before, lies in what {name} forms, and would be moved"
            hint = "form that feature before the sheet is cut, or move the curve away from it"
            yield _hole_issue(message, clearance, margin, hint)
            continue
        tool_clearances = [
            (
                shapely.distance(ring, _plan_curve(centres)) - radius - hole.face_offset - slack,
                forming_pass.name,
            )
            for (forming_pass, path), pass_radii in zip(paths, radii, strict=True)
            for centres, radius in zip((path.forming_centre, path.support_centre), pass_radii, strict=True)
            if centres is not None
        ]
        clearance, name = min(tool_clearances, key=lambda pair: pair[0])
        if clearance < margin:
            proximity = f"comes within {clearance / MM:.1f} mm of" if clearance > 0.0 else "goes over"
            message = f"in {name} a tool {proximity} the edges of {hole.name}, which was cut before"
            hint = "form that feature before the sheet is cut, move the curve away, or use a smaller tool"
            yield _hole_issue(message, max(clearance, 0.0), margin, hint)


def _hole_issue(message: str, value: float | None, margin: float, hint: str) -> Issue:
    """Return the issue; ``value`` [m] is the distance that is below ``margin`` [m], None if none applies."""
    message += "" if value is None else f", allowed at least {margin / MM:g} mm (hole_margin_mm)"
    got = None if value is None else float(value) / MM
    limit = None if value is None else margin / MM
    return Issue(
        "forming.holes", message, field="operations.features", value=got, limit=limit, unit="mm", hint=hint
    )


def _plan_region(forming_pass: FormingPass) -> shapely.Geometry:
    return shapely.Polygon(forming_pass.region[:, :2]).buffer(0.0)


def _plan_curve(centres: FloatArray) -> shapely.Geometry:
    return shapely.LineString(centres[:, :2]) if len(centres) > 1 else shapely.Point(centres[0, :2])
