"""Fits plain solids round the collision meshes of makers' URDFs: python urdf/measure_bodies.py NAME=URDF ...

``NAME=URDF#TIP`` where tools are on another link than tool0. What it prints is for bodies.yaml. Each link
becomes up to six boxes and cylinders along the axes of its upright frame (that of the form's angles, all
zero) which hold every point of its meshes and are up to two millimetres larger: a piece is cut in two, square
to an axis or with a round end, where that saves most. A balancer, which follows joint 2, is held by link 1
wherever it may be. Where axes of the URDF are off those of the catalogue, the solids of that link are larger
by as much. The meshes themselves are not part of Tandem.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planner.catalogue import robots
from planner.cell.kinematics import link_frames
from planner.geometry.arrays import FloatArray, exp_rotation, from_parts, from_rpy, inverse, transform
from planner.geometry.mesh_files import read_mesh
from planner.geometry.units import MM
from planner.reading.robot_file import OwnRobotFile, build_robot, find_mesh_file, read_urdf
from planner.reading.urdf import UrdfChain, read_chain

MOST = 6
"""Solids of a link at most."""
SAVES = (0.04, 0.04, 0.04, 0.02, 0.01, 0.02, 0.04)
"""A cut has to save this share of the solid round the whole link: less at the elbow and in the wrist, which
come near to tools."""
CUTS = np.linspace(0.06, 0.94, 23)
"""Where a piece may be cut, as shares of its length."""
NOISE = 1e-3
"""Rounding [mm] of coordinates in mesh files."""
SWEPT = 91
"""Angles of joint 2, over its range, at which a balancer is looked at."""
LINKS = ("base_link", *(f"link_{i}" for i in range(1, 7)))


@dataclasses.dataclass(frozen=True)
class Piece:
    """What of a mesh one solid holds: triangles (F, 3, 3) [mm], none where it is not to be cut again; and the
    volume of the solid [mm3], or what it adds to its neighbour."""

    triangles: FloatArray
    solid: tuple[str, list[float], list[float]]
    volume: float

    @staticmethod
    def of(triangles: FloatArray) -> Piece:
        """The smallest solid that holds triangles."""
        return Piece(triangles, *_held(_outermost(triangles.reshape(-1, 3))))


def solids(
    triangles: FloatArray, saves: float = SAVES[0], wrist: bool = False
) -> list[tuple[str, list[float], list[float]]]:
    """Kind, size and centre of solids that hold triangles (F, 3, 3), all in mm.

    ``wrist``: the link bears axis 5, about which its end is round: along y through the origin.
    """
    whole = Piece.of(triangles)
    pieces = [whole]
    if wrist and (triangles[:, :, 2] > 0.0).any():
        pieces = _rounded(triangles, 1, 2, 1.0, np.zeros(2))
        pieces[1:] = [Piece.of(_beside(part.triangles, pieces[0].solid)) for part in pieces[1:]]
    while len(pieces) < MOST:
        options = [
            (piece.volume - sum(part.volume for part in parts), index, parts)
            for index, piece in enumerate(pieces)
            if len(piece.triangles)
            for parts in _cuts(piece.triangles)
        ]
        saved, index, parts = max(options, key=lambda option: option[0], default=(0.0, 0, []))
        if saved < saves * whole.volume:
            break
        pieces[index : index + 1] = parts
    return [piece.solid for piece in pieces]


def _cuts(triangles: FloatArray) -> list[list[Piece]]:
    """Ways to hold triangles by two solids: cut square to an axis, or with a round end."""
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    out = []
    for axis in range(3):
        for place in low[axis] + CUTS * (high[axis] - low[axis]):
            parts = [sign * _beyond(sign * triangles, axis, sign * place) for sign in (1.0, -1.0)]
            out += [[Piece.of(part) for part in parts]] if all(map(len, parts)) else []
        for along in (i for i in range(3) if i != axis):
            across = 3 - axis - along
            radius = 0.5 * (high[across] - low[across])
            if radius >= high[along] - low[along]:
                continue
            for sign, end in ((1.0, high), (-1.0, low)):
                middle = np.array([end[along] - sign * radius, 0.5 * (low + high)[across]])
                parts = _rounded(triangles, axis, along, sign, np.round(2.0 * middle) / 2.0)
                out += [parts] if len(parts) == 2 else []
    return out


def _rounded(triangles: FloatArray, axis: int, along: int, sign: float, middle: FloatArray) -> list[Piece]:
    """The end of triangles in the direction ``sign`` of ``along`` in a cylinder parallel to ``axis`` through
    ``middle`` (2,), in ``along`` and the third direction; and the rest."""
    across = 3 - axis - along
    end = sign * _beyond(sign * triangles, along, sign * middle[0])
    rest = -sign * _beyond(-sign * triangles, along, -sign * middle[0])
    points = end.reshape(-1, 3)
    radius = -float(_down(-np.linalg.norm(points[:, [along, across]] - middle, axis=1).max()))
    low, high = float(_down(points[:, axis].min())), -float(_down(-points[:, axis].max()))
    centre = np.zeros(3)
    centre[[axis, along, across]] = 0.5 * (low + high), *middle
    solid = (f"cylinder_{'xyz'[axis]}", [radius, float(high - low)], centre.tolist())
    half = 0.5 * np.pi * radius**2 * (high - low)  # the other half lies within the rest, or nearly
    held = Piece(np.empty((0, 3, 3)), solid, float(half))
    return [held, Piece.of(rest)] if len(rest) else [held]


def _beside(triangles: FloatArray, solid: tuple[str, list[float], list[float]]) -> FloatArray:
    """Those of triangles (F, 3, 3) that are not whole in a cylinder along y: these need no second solid."""
    (radius, length), centre = solid[1], np.array(solid[2])
    off = triangles - centre
    out = (np.hypot(off[..., 0], off[..., 2]) > radius) | (np.abs(off[..., 1]) > 0.5 * length)
    return np.asarray(triangles[out.any(axis=1)])


def _outermost(points: FloatArray) -> FloatArray:
    """Those of points (P, 3) that are corners of their hull; all where they have none."""
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # flat
        return points


def _beyond(triangles: FloatArray, axis: int, place: float) -> FloatArray:
    """What of triangles (F, 3, 3) lies at ``place`` or beyond: whole ones, and cut ones as one or two."""
    above = triangles[:, :, axis] >= place
    out = [triangles[above.all(axis=1)]]
    for count in (1, 2):
        cut = above.sum(axis=1) == count
        # the corner that is on its own side comes first
        alone = np.argmax(above[cut] == (count == 1), axis=1)
        a, b, c = (triangles[cut][np.arange(cut.sum()), (alone + k) % 3] for k in range(3))
        ab, ac = (
            a + (other - a) * ((place - a[:, axis]) / (other - a)[:, axis])[:, None] for other in (b, c)
        )
        if count == 1:
            out.append(np.stack([a, ab, ac], axis=1))
        else:
            out += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(out)


def _held(points: FloatArray) -> tuple[tuple[str, list[float], list[float]], float]:
    """The smallest of the box and the cylinders along the axes that hold points (P, 3), and its volume."""
    low, high = _down(points.min(axis=0)), -_down(-points.max(axis=0))
    size, centre = high - low, 0.5 * (low + high)
    best, least = ("box", size.tolist(), centre.tolist()), float(np.prod(size))
    for axis in range(3):
        rest = [i for i in range(3) if i != axis]
        around = np.round(2.0 * _middle(points[:, rest])) / 2.0
        radius = -float(_down(-np.linalg.norm(points[:, rest] - around, axis=1).max()))
        if np.pi * radius**2 * size[axis] < least:
            least, place = float(np.pi * radius**2 * size[axis]), centre.copy()
            place[rest] = around
            best = (f"cylinder_{'xyz'[axis]}", [radius, float(size[axis])], place.tolist())
    return best, least


def _down(value: FloatArray) -> FloatArray:
    """Whole millimetres below, or a file's rounding above: else a foot at z = 0 would stand in the floor."""
    return np.asarray(np.floor(value + NOISE))


def _middle(points: FloatArray) -> FloatArray:
    """The centre (2,) of nearly the smallest circle that holds points (P, 2) (Badoiu and Clarkson 2003)."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    for step in range(1, 100):
        far = points[np.argmax(np.linalg.norm(points - centre, axis=1))]
        centre = centre + (far - centre) / (step + 3)
    return centre


def links(path: Path, tip: str = "tool0") -> list[FloatArray]:
    """Triangles (F, 3, 3) [mm] of the base and of links 1 to 6 of a URDF's arm, in their upright frames;
    link 1 has its balancers, at each angle of joint 2."""
    chain = read_chain(read_urdf(path), "base_link", tip)
    spec = _spec(path, chain)
    frames = link_frames(build_robot(spec, path.parent), np.zeros(6))
    upright = np.concatenate([np.eye(4)[None], frames[:6]])
    out: list[list[FloatArray]] = [[] for _ in LINKS]
    for one in chain.shapes:
        if one.kind != "mesh":
            sys.exit(f"{path}: a body of {one.link} is no mesh but a {one.kind}")
        index = chain.links.index(one.link)
        pose = inverse(upright[index]) @ chain.zero[index] @ one.pose
        out[index].append(_triangles(one.file, one.size, spec, path, pose))
    out[1] += _balancers(chain, spec, path, inverse(upright[1]))
    return [np.concatenate(triangles) for triangles in out]


def off_catalogue(name: str, path: Path, tip: str = "tool0") -> FloatArray:
    """How much longer or shorter (7,) [mm] the base and links of a URDF are than those of the arm that is
    built in; link 3 and link 4 together are the forearm."""
    here = build_robot(_spec(path, read_chain(read_urdf(path), "base_link", tip)), path.parent).form
    off = np.linalg.norm(here.steps - robots.robot(name).form.steps, axis=1) / MM
    return np.asarray(off[[0, 1, 2, 3, 3, 5, 6]])


def _spec(path: Path, chain: UrdfChain) -> OwnRobotFile:
    return OwnRobotFile(
        urdf=path.name,
        name="arm",
        tip=chain.tip_link,
        family="generic",
        payload_kg=1.0,
        left_out=chain.other_joints,
    )


def _triangles(
    file: str, scale: tuple[float, ...], spec: OwnRobotFile, path: Path, pose: FloatArray
) -> FloatArray:
    """Triangles (F, 3, 3) [mm] of a mesh that a URDF names, at ``pose`` (4, 4)."""
    there = find_mesh_file(file, spec.meshes, path, path.parent)
    if there is None:
        sys.exit(f"{path}: the mesh {file} is not there")
    most = max(abs(v) for v in scale)
    mesh = read_mesh(there, 1.0, most)
    return np.asarray(transform(pose, mesh.vertices * (np.array(scale) / most))[mesh.faces] / MM)


def _balancers(chain: UrdfChain, spec: OwnRobotFile, path: Path, pose: FloatArray) -> list[FloatArray]:
    """Triangles [mm] of all links that follow joint 2, at ``SWEPT`` of its angles each; ``pose`` (4, 4): the
    base with axis 1 at zero in the frame wanted."""
    root, second = ET.fromstring(read_urdf(path)), chain.joints[1]
    above = {joint.find("child").get("link"): joint for joint in root.findall("joint")}  # type: ignore[union-attr]
    out = []
    for link in root.findall("link"):
        joint = above.get(link.get("name"))
        follows = None if joint is None else joint.find("mimic")
        if follows is None or follows.get("joint") != second:
            continue
        for q in np.linspace(chain.lower[1], chain.upper[1], SWEPT):
            here = pose @ _place(above, link.get("name"), second, q)
            for collision in link.findall("collision"):
                file = str(collision.find("geometry/mesh").get("filename"))  # type: ignore[union-attr]
                scale = tuple(_three(collision.find("geometry/mesh"), "scale", "1 1 1"))
                out.append(_triangles(file, scale, spec, path, here @ _origin(collision)))
    return out


def _place(above: dict[str | None, ET.Element], link: str | None, second: str, q: float) -> FloatArray:
    """The pose (4, 4) of a link in the base with joint 2 at ``q`` [rad], the others at zero."""
    if link not in above:
        return np.eye(4)
    joint, follows = above[link], above[link].find("mimic")
    turn = q if joint.get("name") == second else 0.0
    if follows is not None and follows.get("joint") == second:
        turn = q * float(follows.get("multiplier", "1")) + float(follows.get("offset", "0"))
    axis = _three(joint.find("axis"), "xyz", "1 0 0")
    slides = joint.get("type") == "prismatic"
    moved = (
        from_parts(np.eye(3), turn * axis) if slides else from_parts(exp_rotation(turn * axis), np.zeros(3))
    )
    parent = joint.find("parent").get("link")  # type: ignore[union-attr]
    return np.asarray(_place(above, parent, second, q) @ _origin(joint) @ moved)


def _origin(element: ET.Element) -> FloatArray:
    origin = element.find("origin")
    return from_rpy(_three(origin, "xyz", "0 0 0"), _three(origin, "rpy", "0 0 0"))


def _three(element: ET.Element | None, key: str, default: str) -> FloatArray:
    return np.array([float(v) for v in (default if element is None else element.get(key, default)).split()])


def main() -> None:
    """Prints the rows of the arms."""
    for word in sys.argv[1:]:
        name, _, file = word.partition("=")
        file, _, tip = file.partition("#")
        path, tip = Path(file), tip or "tool0"
        known = name in robots.robot_names()
        more = np.ceil(off_catalogue(name, path, tip) - 1e-3) if known else np.zeros(len(LINKS))
        print(f"{name}:")  # noqa: T201
        for index, (link, triangles) in enumerate(zip(LINKS, links(path, tip), strict=True)):
            rows = []
            for kind, size, centre in solids(triangles, SAVES[index], wrist=index == 4):
                size = _grown(kind, size, float(more[index]))
                if index == 0:
                    size, centre = _standing(kind, size, centre)
                rows.append(f"[{kind}, {[_plain(v) for v in size]}, {[_plain(v) for v in centre]}]")
            print(f"  {link}: [{', '.join(rows)}]")  # noqa: T201


def _grown(kind: str, size: list[float], more: float) -> list[float]:
    """The size of a solid with ``more`` [mm] on every side."""
    sides = [2.0] * 3 if kind == "box" else [1.0, 2.0]
    return [value + more * side for value, side in zip(size, sides, strict=True)]


def _standing(kind: str, size: list[float], centre: list[float]) -> tuple[list[float], list[float]]:
    """A solid of the foot without what of it is below z = 0, where the arm is bolted down."""
    below = 0.5 * size[-1] - centre[2]
    if below <= 0.0 or kind in ("cylinder_x", "cylinder_y"):
        return size, centre
    return [*size[:-1], size[-1] - below], [*centre[:2], centre[2] + 0.5 * below]


def _plain(value: float) -> float | int:
    return int(value) if value == int(value) else float(value)


if __name__ == "__main__":
    main()
