"""Motions of Tandem as values of COMPAS and COMPAS FAB; frames and meshes of COMPAS in problems.

>>> import tandem_client, tandem_compas
>>> client = tandem_client.Client("https://plans.example.org", token)
>>> motion = client.motion(job)                               # or tandem_compas.read("out")
>>> frames = tandem_compas.frames(motion, "left")
>>> trajectory = tandem_compas.trajectory(motion, "left")

What comes out is in metres and radians, as COMPAS FAB counts. Frames and meshes need ``compas``,
configurations ``compas_robots``, trajectories ``compas_fab``. Python 3.9 or newer.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from compas.datastructures import Mesh
from compas.geometry import Frame

if TYPE_CHECKING:
    from compas_fab.robots import JointTrajectory
    from compas_robots import Configuration

MM: Final = 1e-3
"""A millimetre in metres."""
FORMAT: Final = 1
"""Number of the form of motions that is read here."""


def read(path: str | PathLike[str]) -> dict[str, Any]:
    """The motion in a result folder. Raises ``ValueError`` for another form, ``OSError`` where there is
    none."""
    motion: dict[str, Any] = json.loads((Path(path) / "motion.json").read_text("utf-8"))
    if motion.get("motion") != FORMAT:
        raise ValueError(
            f"{path}: form {motion.get('motion')} of motion.json, {FORMAT} is read here; update one"
        )
    return motion


def operation(motion: Mapping[str, Any], name: str | None = None) -> dict[str, Any]:
    """An operation by its name; without one the only one there is."""
    found = {one["name"]: one for one in motion["operations"]}
    if name is None and len(found) == 1:
        return dict(next(iter(found.values())))
    if name not in found:
        raise ValueError(f"operation: got {name!r}, allowed are {', '.join(found)}")
    return dict(found[name])


def frames(motion: Mapping[str, Any], arm: str, name: str | None = None) -> list[Frame]:
    """Frames at an arm's TCP in the world [m], one a target of an operation."""
    return [_frame(plane) for plane in _way(motion, arm, name)["tcp"]]


def base(motion: Mapping[str, Any], arm: str) -> Frame:
    """The frame of an arm's base in the world [m]."""
    return _frame(_arm(motion, arm)["base"])


def block(motion: Mapping[str, Any], target: int = 0, name: str | None = None) -> Frame:
    """The frame of the block in the world [m] at a target; of one that is held, in its holder's TCP then."""
    own = operation(motion, name)
    if "plane" in own["block"]:
        return _frame(own["block"]["plane"])
    holder = _frame(own["arms"][own["block"]["held_by"]]["tcp"][target])
    found: Frame = holder.to_world_coordinates(_frame(own["block"]["in_tcp"]))
    return found


def configurations(
    motion: Mapping[str, Any], arm: str, name: str | None = None, joints: Sequence[str] | None = None
) -> list[Configuration]:
    """Joints of an arm [rad], one configuration a target; ``joints``: other names for them, as a model of
    the whole cell has."""
    from compas_robots import Configuration

    names = _joints(motion, arm, joints)
    rows = _way(motion, arm, name)["joints_deg"]
    return [Configuration.from_revolute_values([math.radians(one) for one in row], names) for row in rows]


def trajectory(
    motion: Mapping[str, Any], arm: str, name: str | None = None, joints: Sequence[str] | None = None
) -> JointTrajectory:
    """The joints of an arm over the time of an operation, from its first target on."""
    from compas_fab.robots import Duration, JointTrajectory, JointTrajectoryPoint

    times = operation(motion, name)["time_s"]
    points = []
    for own, seconds in zip(configurations(motion, arm, name, joints), times):
        whole, rest = divmod(round(seconds * 1e9), 10**9)
        points.append(
            JointTrajectoryPoint(
                own.joint_values,
                own.joint_types,
                time_from_start=Duration(whole, rest),
                joint_names=own.joint_names,
            )
        )
    return JointTrajectory(points, _joints(motion, arm, joints), fraction=1.0)


def meshes(found: Mapping[str, tuple[Any, Any]]) -> dict[str, Mesh]:
    """What ``client.meshes`` gives, in metres."""
    return {
        name: Mesh.from_vertices_and_faces([[MM * x for x in point] for point in points], faces)
        for name, (points, faces) in found.items()
    }


def mesh(part: Mesh, unit: str = "m") -> dict[str, Any]:
    """A mesh as a problem has one: ``{"front": {"mesh": mesh(part)}}``; ``unit`` of its vertices."""
    vertices, faces = part.to_vertices_and_faces()
    return {"file": (vertices, faces), "unit": unit}


def pose(frame: Frame) -> dict[str, list[float]]:
    """A frame [m] as problems and cells have poses: of bases, of the stock's place, of obstacles."""
    turns = frame.euler_angles(static=True, axes="xyz")
    return {"xyz_mm": [one / MM for one in frame.point], "rpy_deg": [math.degrees(one) for one in turns]}


def targets(tcp: Mapping[str, Sequence[Frame]], feed_mm_s: float) -> bytes:
    """The file of an operation ``process: targets``, whose arms pass frames [m] at a feed: for ``files`` of
    ``client.submit``. Raises ``ValueError`` where arms have other numbers of frames."""
    counts = {arm: len(own) for arm, own in tcp.items()}
    if len(set(counts.values())) != 1:
        raise ValueError(f"frames: got {counts}; give each arm as many")
    rows: list[dict[str, float]] = [{"feed_mm_s": feed_mm_s} for _ in range(min(counts.values()))]
    for arm, own in tcp.items():
        for row, frame in zip(rows, own):
            row.update(_columns(arm, frame))
    return json.dumps(rows).encode()


def _columns(arm: str, frame: Frame) -> Iterator[tuple[str, float]]:
    for axis, value in zip("xyz", frame.point):
        yield f"{arm}.{axis}_mm", value / MM
    for axis, value in zip("wxyz", frame.quaternion.wxyz):
        yield f"{arm}.q{axis}", value


def _frame(plane: Sequence[float]) -> Frame:
    return Frame([MM * one for one in plane[:3]], plane[3:6], plane[6:9])


def _arm(motion: Mapping[str, Any], arm: str) -> Mapping[str, Any]:
    if arm not in motion["arms"]:
        raise ValueError(f"arm: got {arm!r}, allowed are {', '.join(motion['arms'])}")
    found: Mapping[str, Any] = motion["arms"][arm]
    return found


def _way(motion: Mapping[str, Any], arm: str, name: str | None) -> Mapping[str, Any]:
    own = operation(motion, name)
    if arm not in own["arms"]:
        raise ValueError(f"arm: got {arm!r}, in operation {own['name']} move {', '.join(own['arms'])}")
    found: Mapping[str, Any] = own["arms"][arm]
    return found


def _joints(motion: Mapping[str, Any], arm: str, joints: Sequence[str] | None) -> list[str]:
    names = _arm(motion, arm)["joints"]
    if joints is not None and len(joints) != len(names):
        raise ValueError(f"joints: got {len(joints)} names, {arm} has {len(names)}")
    return list(names if joints is None else joints)
