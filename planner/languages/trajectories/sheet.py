"""Rows of the setup sheet for a ROS 2 controller, which moves all joints, and for the runner."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.problem import Arm, Problem
from planner.report.plugin_contributions import ControllerCheck, ControllerSetup, ReportOfLanguage, SetupRow


def _checks(setup: ControllerSetup) -> list[ControllerCheck]:
    """Return rows of the setup sheet on the settings of the controller and of the runner.

    Each has the item and its required state.
    """
    controller = setup.problem.cell.controller
    rows: list[ControllerCheck] = []
    names = [
        f"{controller.joint_prefix.get(arm.name, '')}{joint}"
        for arm in setup.arms
        for joint in arm.data.joints
    ]
    path, goal = (
        float(np.rad2deg(value)) for value in (controller.path_tolerance, controller.goal_tolerance)
    )
    for signal in setup.signals:
        rows.append((f"the service that sets {signal}", "answers once the output has the value"))
        rows.append(
            (f"{signal} with the runner killed, the computer off, its network unplugged", "falls within 1 s")
        )
        rows.append((f"the power of {signal} at a safety stop and with the drives", "falls: wired so"))
    return [
        *rows,
        ("controller", "one joint_trajectory_controller for all joints, interpolation_method splines"),
        ("its joints, in any order", ", ".join(names)),
        ("state interfaces", "position and velocity of all joints"),
        ("allow_nonzero_velocity_at_trajectory_end, allow_partial_joints_goal", "false"),
        ("interpolate_from_desired_state (open_loop_control in Humble)", "true"),
        (
            "version of joint_trajectory_controller",
            "2.37 (Humble), 4.12 (Jazzy), or later: earlier versions ignore the tolerances of goals",
        ),
        (
            "joints of the URDF at the computer",
            "same zero and direction as the joints that the job was planned with",
        ),
        ("a hand on a joint while it moves slowly: ends the move", f"beyond {path:g} deg from its path"),
        ("after each move all joints", f"within {goal:g} deg"),
        ("speed scaling at the controller or at the pendant", "100 %: otherwise the feed differs"),
        ("tool and load at each arm's controller", "as in the tool rows of the file"),
        ("time of the longest move", "as planned"),
        ("after a stop of any kind", "power off, wire off, arms home by hand; start from the beginning"),
    ]


def _programs(_: Problem, arms: Sequence[Arm]) -> list[SetupRow]:
    names = ", ".join(arm.name for arm in arms)
    return [(f"trajectories of {names}", "one file for ROS 2, not run on a controller yet")]


REPORT: Final = ReportOfLanguage(checks=_checks, programs=_programs)
