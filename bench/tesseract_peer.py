"""Tesseract's Descartes planner on a job that lies in a folder: ``python tesseract_peer.py FOLDER``.

Needs the wheel ``tesseract-robotics-nanobind``, which brings numpy, and nothing of Tandem, so that any
interpreter can run it that loads the wheel. The folder holds ``cell.urdf``, ``cell.srdf``, the plugins that
this one names, and ``job.json``; what was found goes to ``found.json``. Without a folder it only says whether
the wheel loads: nothing and exit code 0, or the reason and 1.
"""

from __future__ import annotations

import json
import os
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

GROUP, PROFILE, SPACE = "manipulator", "DEFAULT", "DescartesMotionPlannerTask"


def load() -> dict[str, Any]:
    """All names of the wheel that are used here; raises ``ImportError``."""
    import tesseract_robotics.tesseract_collision as collision
    import tesseract_robotics.tesseract_command_language as command
    import tesseract_robotics.tesseract_common as common
    import tesseract_robotics.tesseract_environment as environment
    import tesseract_robotics.tesseract_motion_planners as planners
    import tesseract_robotics.tesseract_motion_planners_descartes as descartes

    names: dict[str, Any] = {}
    for module in (collision, command, common, environment, planners, descartes):
        names |= {name: getattr(module, name) for name in dir(module) if not name.startswith("_")}
    return names


def plan(folder: Path) -> dict[str, Any]:
    """Joint path of the job, processor time [s] from poses to path, peak memory [MB] and versions.

    ``q`` is None where Tesseract finds nothing, with its ``message``.
    """
    t = load()
    job = json.loads((folder / "job.json").read_text())
    locator = t["GeneralResourceLocator"]()
    env = t["Environment"]()
    if not env.init(str(folder / "cell.urdf"), str(folder / "cell.srdf"), locator):
        raise RuntimeError("Tesseract does not take the cell")
    info = t["ManipulatorInfo"]()
    info.tcp_frame, info.working_frame = "tcp", "base_link"
    info.manipulator, info.manipulator_ik_solver = GROUP, "OPWInvKin"
    start = time.process_time()
    profile = t["DescartesDefaultMoveProfileD"]()
    profile.target_pose_fixed = False
    profile.target_pose_sample_axis = np.array([0.0, 0.0, 1.0])
    profile.target_pose_sample_resolution = job["resolution"]
    profile.target_pose_sample_min, profile.target_pose_sample_max = job["spin"]
    profile.enable_collision = job["collisions"]
    profile.allow_collision = False
    profile.enable_edge_collision = False
    profile.vertex_contact_manager_config = t["ContactManagerConfig"](job["clearance"])
    profiles = t["ProfileDictionary"]()
    profiles.addProfile(SPACE, PROFILE, t["cast_DescartesMoveProfileD"](profile))
    program = t["CompositeInstruction"](PROFILE, info)
    for x, y, z, qx, qy, qz, qw in job["poses"]:
        pose = t["Isometry3d"].Identity() * t["Translation3d"](x, y, z)
        pose = pose * t["Quaterniond"].from_xyzw(qx, qy, qz, qw)
        point = t["CartesianWaypointPoly_wrap_CartesianWaypoint"](t["CartesianWaypoint"](pose))
        move = t["MoveInstruction"](point, t["MoveInstructionType_LINEAR"], PROFILE)
        program.appendMoveInstruction(t["MoveInstructionPoly_wrap_MoveInstruction"](move))
    request = t["PlannerRequest"]()
    request.instructions, request.env, request.profiles = program, env, profiles
    answer = t["DescartesMotionPlannerD"](SPACE).solve(request)
    seconds = time.process_time() - start
    q = [_joints(t, own) for own in answer.results] if answer.successful else None
    return {
        "q": q,
        "message": answer.message,
        "seconds": seconds,
        "memory_mb": peak_memory(),
        "version": f"{version('tesseract-robotics-nanobind')} on {os.confstr('CS_GNU_LIBC_VERSION')}",
    }


def peak_memory() -> float:
    """Return the peak memory [MB] of this process alone.

    The value of ``getrusage`` begins with the parent's.
    """
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError("/proc/self/status has no VmHWM")


def _joints(t: dict[str, Any], instruction: Any) -> list[float]:
    waypoint = t["InstructionPoly_as_MoveInstructionPoly"](instruction).getWaypoint()
    return [float(v) for v in t["WaypointPoly_as_StateWaypointPoly"](waypoint).getPosition().ravel()]


def main(arguments: list[str]) -> int:
    """Plan the job of a folder, or say whether the wheel loads."""
    if not arguments:
        try:
            load()
        except ImportError as error:
            print(error)
            return 1
        return 0
    folder = Path(arguments[0])
    (folder / "found.json").write_text(json.dumps(plan(folder)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
