"""Forming in stages: which features an operation forms, the sheet as others leave it, and holes in that.

A part may be formed by several operations, each of which names its features; between them the sheet may be
cut. What features move adds up, so a sheet with some of them is the flat and their shares of the part.

A hole gives way under a tool that comes near to it, and one in what is formed later is moved and stretched:
neither is known here. So both the tools and all that an operation forms keep off each curve that was cut by
a stated margin, seen along z; a hole that nothing formed later comes near to stays where it was cut.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planner.geometry.arrays import FloatArray, Mesh, Shape, transform
from planner.geometry.mesh import small_pieces
from planner.geometry.mesh_queries import outer_hull
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.problem import Hole, Stages, Stock
from planner.processes.forming.plan.contact import Pass, ToolPath
from planner.processes.forming.plan.features.tree import (
    FeatureTree,
    OrderStep,
    given_order,
    in_place,
    on_virgin_sheet,
)
from planner.runtime.memoize import memoized


def own_features(
    name: str, features: tuple[int, ...] | None, stages: Stages | None, tree: FeatureTree
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Numbers of the features that were formed before the operation ``name``, and of its own, ascending.

    Raises ``TandemError`` (forming.features): numbers that the part has not, features that are formed twice,
    and those that nothing forms.
    """
    every = {one.id for one in tree.features}
    stages = stages or Stages()
    owner: dict[int, str] = {}
    issues: list[Issue] = []
    for operation, some in (*stages.before, (name, features), *stages.after):
        named = every if some is None else set(some)
        twice = sorted(named & owner.keys())
        if twice:
            what = f"{operation}: {_features(twice)} formed by {owner[twice[0]]} already"
            hint = "name other features, or one operation for all of them; repeats runs each pass again"
            issues.append(_issue(what, hint))
        unknown = sorted(named - every)
        if unknown:
            what = f"{operation}: {_features(unknown)} not there; the part has 1 to {len(every)}"
            issues.append(_issue(what, "see them by: tandem features PART"))
        owner.update(dict.fromkeys(named, operation))
    left = sorted(every - owner.keys())
    if left and not issues:
        what = f"{name}: {_features(left)} formed by no operation"
        issues.append(_issue(what, "name them in one of the operations, or take them out of the part"))
    if issues:
        raise TandemError(issues)
    before = {number for _, some in stages.before for number in (some or ())}
    return tuple(sorted(before)), tuple(sorted(every if features is None else features))


def _features(numbers: Sequence[int]) -> str:
    text = ", ".join(map(str, numbers))
    return f"feature {text} is" if len(numbers) == 1 else f"features {text} are"


def _issue(what: str, hint: str) -> Issue:
    return Issue("forming.features", what, field="operations.features", hint=hint)


def formed_sheet(mesh: Mesh, tree: FeatureTree, done: Sequence[int]) -> Mesh:
    """The lower face of the sheet once the features ``done`` of the part ``mesh`` are formed, at the level
    that each has in the part; what stands inside of one that is not formed is as high over the flat as it is
    over that."""
    if len(done) == len(tree.features):
        return mesh
    height = tree.level + tree.share[np.array(done, dtype=np.int64) - 1].sum(axis=0)
    return Mesh(np.column_stack([mesh.vertices[:, :2], height]), mesh.faces)


STANDS_OUT: Final = 0.2 * MM
"""How far [m] the sheet may stand out of the solids by which bodies keep clear of it, and off the flat
unseen."""


def order_of(
    tree: FeatureTree,
    virgin: bool,
    given: Sequence[int] | None,
    some: Sequence[int] | None,
    before: Sequence[int],
) -> tuple[OrderStep, ...]:
    """The order in which an operation forms features: ``some``, None for all, behind those ``before``; as
    ``given``, or as its strategy has it. Raises ``TandemError`` (forming.order)."""
    if given is not None:
        return given_order(tree, given, virgin, some, before)
    by = on_virgin_sheet if virgin else in_place
    return by(tree, some, before)


def with_states(
    stock: Stock, mesh: Mesh, tree: FeatureTree, order: Sequence[OrderStep], before: Sequence[int]
) -> Stock:
    """The sheet with solids of what stands out of it before the part, of the lower face ``mesh``, is
    finished: once each step of an ``order`` is done, behind the features ``before``.

    What is formed on the virgin sheet stands higher, or lower, than in the part until what is around it
    takes it along, straight along z, through the solids of both.
    """
    sheet = stock.sheet
    if sheet is None:
        return stock
    states = [sorted({*before, *(step.feature for step in order[: k + 1])}) for k in range(len(order))]
    more = _all_standing(mesh, tree, states, float(stock.size[2]), sheet.formed)
    return dataclasses.replace(stock, sheet=dataclasses.replace(sheet, formed=(*sheet.formed, *more)))


@memoized
def _all_standing(
    mesh: Mesh, tree: FeatureTree, states: list[list[int]], thickness: float, known: tuple[Shape, ...]
) -> list[Shape]:
    """Hulls, beside those ``known``, of what stands out of the sheet with the features of each state done."""
    solids = list(known)
    for done in states:
        solids += _standing(formed_sheet(mesh, tree, done), tree.level, thickness, solids)
    return solids[len(known) :]


def _standing(mesh: Mesh, level: float, thickness: float, known: Sequence[Shape]) -> list[Shape]:
    """Hulls, each of one piece of a sheet that stands off its flat ``level`` [m] and out of the solids that
    are ``known``."""
    planes = [_planes(one) for one in known]
    rise = np.array([0.0, 0.0, thickness])
    out = []
    for side in (-1.0, 1.0):
        off = side * (mesh.vertices[:, 2] - level) > STANDS_OUT
        faces = mesh.faces[off[mesh.faces].any(axis=1)]
        edges = np.concatenate([faces[:, :2], faces[:, 1:]])
        count = len(mesh.vertices)
        graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
        label = connected_components(graph, directed=False)[1]
        for piece in np.unique(label[faces[:, 0]]) if len(faces) else ():
            own = mesh.vertices[np.unique(faces[label[faces[:, 0]] == piece])]
            both = np.concatenate([own, own + rise])
            beyond = both[np.abs(both[:, 2] - level - 0.5 * thickness) > 0.5 * thickness + STANDS_OUT]
            if _within(beyond, planes):
                continue
            hull = outer_hull(both)
            out.append(Shape("mesh", (), np.eye(4), hull.vertices, hull.faces))
    return out


def _within(points: FloatArray, planes: Sequence[tuple[FloatArray, FloatArray]]) -> bool:
    """Whether each of ``points`` (P, 3) is in one of some solids, or out of it by no more than
    :data:`STANDS_OUT`."""
    left = points
    for normal, reach in planes:
        if not len(left):
            return True
        off = np.full(len(left), -np.inf if len(normal) else np.inf)
        for n, r in zip(normal, reach, strict=True):
            np.maximum(off, left @ n - r, out=off)
        left = left[off > STANDS_OUT]
    return not len(left)


def _planes(solid: Shape) -> tuple[FloatArray, FloatArray]:
    """Planes (K, 3), (K,) of a convex solid, with normals out of it."""
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


SHOWN_PIECE: Final = 0.8 * MM
"""Triangles at holes that are drawn are no larger than this [m]."""
MOST_SHOWN: Final = 60_000
"""Triangles of a sheet that is drawn at most."""


def shown(mesh: Mesh, holes: Sequence[Hole], after: str) -> dict[str, Any]:
    """The exhibit ``left``, by name, of a sheet whose lower face is ``mesh`` as the operation ``after``
    leaves it; nothing where that is too large to be drawn."""
    corners = mesh.vertices[mesh.faces]
    for hole in holes:
        area = shapely.Polygon(hole.ring).buffer(0.0)
        shapely.prepare(area)
        near = shapely.intersects(area, shapely.polygons(corners[:, :, :2]))
        if not near.any():  # beyond the part's mesh, in the flat sheet around it
            corners = corners if hole.inside else corners[:0]
            continue
        pieces = small_pieces(corners[near], SHOWN_PIECE, MOST_SHOWN)[0]
        middle = pieces.mean(axis=1)
        kept = shapely.contains_xy(area, middle[:, 0], middle[:, 1]) != hole.inside
        corners = np.concatenate([corners[~near] if hole.inside else corners[:0], pieces[kept]])
    if not 0 < len(corners) <= MOST_SHOWN:
        return {}
    vertices, index = np.unique(np.round(corners.reshape(-1, 3), 9), axis=0, return_inverse=True)
    faces = np.asarray(index).reshape(-1, 3)
    return {
        "left": {
            "kind": "left",
            "title": f"The sheet as {after} leaves it",
            "vertices": vertices,
            "faces": faces,
        }
    }


def hole_issues(
    holes: Sequence[Hole],
    margin: float,
    paths: Sequence[tuple[Pass, ToolPath]],
    radii: Sequence[tuple[float, float]],
    slack: float = 0.0,
) -> Iterator[Issue]:
    """Holes (forming.holes) of which an edge may be nearer than ``margin`` [m] to what passes form, or to
    their tools of ``radii`` [m], the forming and the other one of each pass, which may be ``slack`` [m] off
    their ways; and curves outside of which all has dropped."""
    for hole in holes:
        ring = shapely.Polygon(hole.ring).buffer(0.0)
        if not hole.inside:
            what = f"the sheet was cut along {hole.name}, outside of which all drops: its clamp holds nothing"
            yield _of_hole(what, None, margin, "put this operation before the one that cuts it off")
            continue
        own = [(shapely.distance(ring, _moved(one)), one.name) for one, _ in paths]
        apart, name = min(own, key=lambda found: found[0])
        near = max(apart - hole.across, 0.0)
        if near < margin:
            what = f"{hole.name}, which was cut before, is {apart / MM:.1f} mm off what {name} forms"
            what += f", its other edge down to {near / MM:.1f} mm" if hole.across > 0.0 else ""
            if apart == 0.0:
                what = f"{hole.name}, which was cut before, lies in what {name} forms, and would be moved"
            hint = "form that feature before the sheet is cut, or move the curve away from it"
            yield _of_hole(what, near, margin, hint)
            continue
        tools = [
            (shapely.distance(ring, _way(way)) - radius - hole.across - slack, one.name)
            for (one, path), both in zip(paths, radii, strict=True)
            for way, radius in zip((path.former, path.support), both, strict=True)
            if way is not None
        ]
        near, name = min(tools, key=lambda found: found[0])
        if near < margin:
            how = f"comes within {near / MM:.1f} mm of" if near > 0.0 else "goes over"
            what = f"in {name} a tool {how} the edges of {hole.name}, which was cut before"
            hint = "form that feature before the sheet is cut, move the curve away, or take a smaller tool"
            yield _of_hole(what, max(near, 0.0), margin, hint)


def _of_hole(what: str, value: float | None, margin: float, hint: str) -> Issue:
    what += "" if value is None else f"; wanted: {margin / MM:g} mm (hole_margin_mm)"
    got = None if value is None else float(value) / MM
    limit = None if value is None else margin / MM
    return Issue(
        "forming.holes", what, field="operations.features", value=got, limit=limit, unit="mm", hint=hint
    )


def _moved(one: Pass) -> shapely.Geometry:
    return shapely.Polygon(one.region[:, :2]).buffer(0.0)


def _way(places: FloatArray) -> shapely.Geometry:
    return shapely.LineString(places[:, :2]) if len(places) > 1 else shapely.Point(places[0, :2])
