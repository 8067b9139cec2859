"""Motions of Tandem as values of COMPAS and COMPAS FAB, and frames and meshes of COMPAS in problems.

>>> import tandem_client, tandem_compas
>>> client = tandem_client.Client("https://plans.example.org", token)
>>> motion = client.motion(job)                               # or tandem_compas.read("out")
>>> frames = tandem_compas.frames(motion, "left")
>>> trajectory = tandem_compas.trajectory(motion, "left")

Results are in metres and radians, as in COMPAS FAB. Frames and meshes need ``compas``, configurations
``compas_robots``, trajectories ``compas_fab``. Python 3.9 or newer.
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
"""Version of ``motion.json`` that this module reads."""


def read(path: str | PathLike[str]) -> dict[str, Any]:
    """Read the motion of a result folder.

    Args:
        path: Result folder.

    Raises:
        ValueError: The file has another format version.
        OSError: There is no such file.
    """
    motion: dict[str, Any] = json.loads((Path(path) / "motion.json").read_text("utf-8"))
    if motion.get("motion") != FORMAT:
        raise ValueError(
            f"{path}: motion.json has format version {motion.get('motion')}, required is {FORMAT}. "
            "Update the planner or this module."
        )
    return motion


def operation(motion: Mapping[str, Any], name: str | None = None) -> dict[str, Any]:
    """Return an operation by its name. The name may be omitted if there is only one.

    Raises:
        ValueError: No such operation.
    """
    operations = {row["name"]: row for row in motion["operations"]}
    if name is None and len(operations) == 1:
        return dict(next(iter(operations.values())))
    if name not in operations:
        raise ValueError(f"operation: got {name!r}, allowed: {', '.join(operations)}.")
    return dict(operations[name])


def frames(motion: Mapping[str, Any], arm: str, name: str | None = None) -> list[Frame]:
    """Return the frames of an arm's TCP in the world [m], one for each target of an operation."""
    return [_frame(plane) for plane in _arm_path(motion, arm, name)["tcp"]]


def base(motion: Mapping[str, Any], arm: str) -> Frame:
    """Return the frame of an arm's base in the world [m]."""
    return _frame(_arm(motion, arm)["base"])


def block(motion: Mapping[str, Any], target: int = 0, name: str | None = None) -> Frame:
    """Return the frame of the block in the world [m].

    Args:
        motion: Motion.
        target: Target at which a held block is considered, in the TCP of its holder.
        name: Name of the operation.
    """
    operation_data = operation(motion, name)
    if "plane" in operation_data["block"]:
        return _frame(operation_data["block"]["plane"])
    holder = _frame(operation_data["arms"][operation_data["block"]["held_by"]]["tcp"][target])
    world_frame: Frame = holder.to_world_coordinates(_frame(operation_data["block"]["in_tcp"]))
    return world_frame


def configurations(
    motion: Mapping[str, Any], arm: str, name: str | None = None, joints: Sequence[str] | None = None
) -> list[Configuration]:
    """Return the joints of an arm [rad], one configuration for each target.

    Args:
        motion: Motion.
        arm: Name of the arm.
        name: Name of the operation.
        joints: Other joint names, as in a model of the whole cell.
    """
    from compas_robots import Configuration

    names = _joints(motion, arm, joints)
    rows = _arm_path(motion, arm, name)["joints_deg"]
    return [Configuration.from_revolute_values([math.radians(angle) for angle in row], names) for row in rows]


def trajectory(
    motion: Mapping[str, Any], arm: str, name: str | None = None, joints: Sequence[str] | None = None
) -> JointTrajectory:
    """Return the joint trajectory of an arm in an operation, from its first target on.

    Args:
        motion: Motion.
        arm: Name of the arm.
        name: Name of the operation.
        joints: Other joint names, as in a model of the whole cell.
    """
    from compas_fab.robots import Duration, JointTrajectory, JointTrajectoryPoint

    times = operation(motion, name)["time_s"]
    points = []
    for configuration, seconds in zip(configurations(motion, arm, name, joints), times):
        whole, rest = divmod(round(seconds * 1e9), 10**9)
        points.append(
            JointTrajectoryPoint(
                configuration.joint_values,
                configuration.joint_types,
                time_from_start=Duration(whole, rest),
                joint_names=configuration.joint_names,
            )
        )
    return JointTrajectory(points, _joints(motion, arm, joints), fraction=1.0)


def meshes(found: Mapping[str, tuple[Any, Any]]) -> dict[str, Mesh]:
    """Convert the result of ``client.meshes`` to meshes in metres."""
    return {
        name: Mesh.from_vertices_and_faces([[MM * x for x in point] for point in points], faces)
        for name, (points, faces) in found.items()
    }


def mesh(part: Mesh, unit: str = "m") -> dict[str, Any]:
    """Convert a mesh to the mapping that problem files use, for example as ``{"front": {"mesh": ...}}``.

    Args:
        part: Mesh.
        unit: Unit of its vertices.
    """
    vertices, faces = part.to_vertices_and_faces()
    return {"file": (vertices, faces), "unit": unit}


def pose(frame: Frame) -> dict[str, list[float]]:
    """Convert a frame [m] to the form of poses in problems and cells: bases, stock, obstacles."""
    turns = frame.euler_angles(static=True, axes="xyz")
    return {
        "xyz_mm": [value / MM for value in frame.point],
        "rpy_deg": [math.degrees(value) for value in turns],
    }


def targets(tcp: Mapping[str, Sequence[Frame]], feed_mm_s: float) -> bytes:
    """Return the file of an operation ``process: targets``, for ``files`` of ``client.submit``.

    Args:
        tcp: Frames [m] by arm, equal in number.
        feed_mm_s: Feed [mm/s].

    Raises:
        ValueError: Arms have different numbers of frames.
    """
    counts = {arm: len(arm_frames) for arm, arm_frames in tcp.items()}
    if len(set(counts.values())) != 1:
        raise ValueError(f"frames: got {counts}. Give the same number for each arm.")
    rows: list[dict[str, float]] = [{"feed_mm_s": feed_mm_s} for _ in range(min(counts.values()))]
    for arm, arm_frames in tcp.items():
        for row, frame in zip(rows, arm_frames):
            row.update(_columns(arm, frame))
    return json.dumps(rows).encode()


def _columns(arm: str, frame: Frame) -> Iterator[tuple[str, float]]:
    for axis, value in zip("xyz", frame.point):
        yield f"{arm}.{axis}_mm", value / MM
    for axis, value in zip("wxyz", frame.quaternion.wxyz):
        yield f"{arm}.q{axis}", value


def _frame(plane: Sequence[float]) -> Frame:
    return Frame([MM * value for value in plane[:3]], plane[3:6], plane[6:9])


def _arm(motion: Mapping[str, Any], arm: str) -> Mapping[str, Any]:
    if arm not in motion["arms"]:
        raise ValueError(f"arm: got {arm!r}, allowed: {', '.join(motion['arms'])}.")
    arm_data: Mapping[str, Any] = motion["arms"][arm]
    return arm_data


def _arm_path(motion: Mapping[str, Any], arm: str, name: str | None) -> Mapping[str, Any]:
    operation_data = operation(motion, name)
    if arm not in operation_data["arms"]:
        raise ValueError(
            f"arm: got {arm!r}, operation {operation_data['name']} moves {', '.join(operation_data['arms'])}."
        )
    path: Mapping[str, Any] = operation_data["arms"][arm]
    return path


def _joints(motion: Mapping[str, Any], arm: str, joints: Sequence[str] | None) -> list[str]:
    names = _arm(motion, arm)["joints"]
    if joints is not None and len(joints) != len(names):
        raise ValueError(f"joints: got {len(joints)} names, arm {arm} has {len(names)} joints.")
    return list(names if joints is None else joints)
