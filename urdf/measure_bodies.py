"""Fits plain solids round the collision meshes of makers' URDFs: python urdf/measure_bodies.py NAME=URDF ...

What it prints is for bodies.yaml. Each link becomes up to four boxes and cylinders along the axes of its
upright frame (that of the OPW angles, all zero) which hold every point of its meshes and are up to two
millimetres larger: a piece is cut in two, square to an axis, where that saves most of its box. The meshes
themselves are not part of Tandem.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from planner.cell.kinematics import link_frames
from planner.geometry.arrays import FloatArray, inverse, transform
from planner.geometry.mesh import read_mesh
from planner.geometry.units import MM
from planner.reading.robot_file import OwnRobotFile, mesh_file, read_urdf, robot_of
from planner.reading.urdf import read_chain

MOST = 4
"""Solids of a link at most."""
SAVES = 0.08
"""A cut has to save this share of the box round the link."""
CUTS = np.linspace(0.06, 0.94, 23)
"""Where a piece may be cut, as shares of its length."""
LINKS = ("base_link", *(f"link_{i}" for i in range(1, 7)))


def solids(triangles: FloatArray) -> list[tuple[str, list[float], list[float]]]:
    """Kind, size and centre of solids that hold triangles (F, 3, 3), all in mm."""
    pieces = [triangles]
    whole = _volume(triangles)
    while len(pieces) < MOST:
        options = [
            (_volume(piece) - sum(map(_volume, parts)), index, parts)
            for index, piece in enumerate(pieces)
            for parts in _cuts(piece)
        ]
        saved, index, parts = max(options, key=lambda option: option[0], default=(0.0, 0, []))
        if saved < SAVES * whole:
            break
        pieces[index : index + 1] = parts
    return [_held(piece.reshape(-1, 3)) for piece in pieces]


def _volume(triangles: FloatArray) -> float:
    return float(np.prod(triangles.max(axis=(0, 1)) - triangles.min(axis=(0, 1))))


def _cuts(triangles: FloatArray) -> list[list[FloatArray]]:
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    out = []
    for axis in range(3):
        for place in low[axis] + CUTS * (high[axis] - low[axis]):
            parts = [sign * _beyond(sign * triangles, axis, sign * place) for sign in (1.0, -1.0)]
            out += [parts] if all(map(len, parts)) else []
    return out


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


def _held(points: FloatArray) -> tuple[str, list[float], list[float]]:
    """The smallest of the box and the three cylinders along the axes that hold points (P, 3)."""
    low, high = np.floor(points.min(axis=0)), np.ceil(points.max(axis=0))
    size, centre = high - low, 0.5 * (low + high)
    best, least = ("box", size.tolist(), centre.tolist()), float(np.prod(size))
    for axis in range(3):
        rest = [i for i in range(3) if i != axis]
        around = np.round(2.0 * _middle(points[:, rest])) / 2.0
        radius = float(np.ceil(np.linalg.norm(points[:, rest] - around, axis=1).max()))
        if np.pi * radius**2 * size[axis] < least:
            least, place = np.pi * radius**2 * size[axis], centre.copy()
            place[rest] = around
            best = (f"cylinder_{'xyz'[axis]}", [radius, float(size[axis])], place.tolist())
    return best


def _middle(points: FloatArray) -> FloatArray:
    """The centre (2,) of nearly the smallest circle that holds points (P, 2) (Badoiu and Clarkson 2003)."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    for step in range(1, 100):
        far = points[np.argmax(np.linalg.norm(points - centre, axis=1))]
        centre = centre + (far - centre) / (step + 3)
    return centre


def links(path: Path) -> list[FloatArray]:
    """Triangles (F, 3, 3) [mm] of the base and of links 1 to 6 of a URDF's arm, in their upright frames."""
    chain = read_chain(read_urdf(path), "base_link", "tool0")
    spec = OwnRobotFile(urdf=path.name, name="arm", family="abb", payload_kg=1.0, left_out=chain.beside)
    frames = link_frames(robot_of(spec, path.parent), np.zeros(6))
    upright = np.concatenate([np.eye(4)[None], frames[:6]])
    out: list[list[FloatArray]] = [[] for _ in LINKS]
    for one in chain.shapes:
        file = mesh_file(one.file, spec, path)
        if one.kind != "mesh" or file is None:
            sys.exit(f"{path}: the {one.kind} {one.file} of {one.link} is no mesh that is there")
        mesh = read_mesh(file, 1.0)
        index = chain.links.index(one.link)
        pose = inverse(upright[index]) @ chain.zero[index] @ one.pose
        out[index].append(transform(pose, mesh.vertices * np.array(one.size))[mesh.faces] / MM)
    return [np.concatenate(triangles) for triangles in out]


def main() -> None:
    """Prints the rows of the arms."""
    for word in sys.argv[1:]:
        name, _, path = word.partition("=")
        print(f"{name}:")  # noqa: T201
        for link, triangles in zip(LINKS, links(Path(path)), strict=True):
            rows = [
                f"[{kind}, {[_plain(v) for v in size]}, {[_plain(v) for v in centre]}]"
                for kind, size, centre in solids(triangles)
            ]
            print(f"  {link}: [{', '.join(rows)}]")  # noqa: T201


def _plain(value: float) -> float | int:
    return int(value) if value == int(value) else value


if __name__ == "__main__":
    main()
