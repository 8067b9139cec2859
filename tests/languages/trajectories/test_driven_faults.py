"""No fault in the trajectory writer leads to a proven file: faults are put into its code, one at a time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.issues import TandemError
from planner.languages.trajectories.writer import curves, program, rows, straight_segments
from planner.languages.writing import write
from planner.proof.prove import Prover
from tests.languages.trajectories import driven_job
from tests.processes.hotwire.proof import straight_job
from tests.proof import small_job

JOBS = {
    "bow": (driven_job.bow_problem, straight_job.claims, lambda: straight_job.plan(driven_job.COUNT)),
    "bent": (driven_job.bent_problem, small_job.claims, small_job.plan),
}


def change_result(function):
    """Return a fault that changes the result of a function."""
    return lambda old: lambda *args, **more: function(old(*args, **more))


def do_nothing(old):
    """Return a fault that does nothing at all."""
    return lambda *args, **more: None


def change_velocities(function):
    """Return a fault in the velocities of a curve."""
    return lambda made: dataclasses.replace(made, v=function(made.v))


def halve_times(curve):
    return dataclasses.replace(curve, t=0.5 * curve.t)


def mirror_joint(curve):
    q = curve.q.copy()
    q[1:-1, 4] = 2.0 * q[0, 4] - q[1:-1, 4]
    return dataclasses.replace(curve, q=q)


def exchange_arms(curve):
    """Exchange the joints of two arms."""
    half = curve.q.shape[1] // 2
    return dataclasses.replace(curve, q=np.roll(curve.q, half, axis=1), v=np.roll(curve.v, half, axis=1))


def later_labels(old):
    return lambda self, made, begun, arms, labels: old(self, made, begun, arms, [labels[0], *labels[:-1]])


def only_the_first(old):
    return lambda self, arms: old(self, arms[:1])


def never_on(old):
    def switch(self, signal, on):
        old(self, signal, on)
        self.outputs_on = []

    return switch


def other_wait(old):
    return lambda self, action, arm: None if action.kind == "wait" else old(self, action, arm)


FAULTS = {
    "velocities_too_high": ("bow", program, "fit_curve", change_result(change_velocities(lambda v: 4.0 * v))),
    "velocities_forgotten": ("bent", program, "fit_curve", change_result(change_velocities(np.zeros_like))),
    "velocities_exchanged": (
        "bent",
        program,
        "fit_curve",
        change_result(change_velocities(lambda v: np.roll(v, 6, axis=1))),
    ),
    "no_spline": ("bow", curves, "_velocities", change_result(np.zeros_like)),
    "times_halved": ("bow", program, "fit_curve", change_result(halve_times)),
    "a_joint_turns_the_other_way": ("bow", program, "fit_curve", change_result(mirror_joint)),
    "arms_exchanged": ("bent", program, "fit_curve", change_result(exchange_arms)),
    "few_decimals": (
        "bow",
        rows,
        "format_fixed",
        lambda old: lambda value, decimals: old(value, min(decimals, 2)),
    ),
    "degrees": (
        "bow",
        program._TrajectoryWriter,
        "_point",
        lambda old: lambda s, t, q, v: old(s, t, np.rad2deg(q), v),
    ),
    "ways_too_fast": ("bow", program, "rest_to_rest_time", change_result(lambda time: 0.2 * time)),
    "begins_at_once": ("bow", program, "settling_time", change_result(lambda time: 0.3 * time)),
    "labels_late": ("bow", program._TrajectoryWriter, "_points", later_labels),
    "nothing_looks": ("bow", program._TrajectoryWriter, "_posture_check", do_nothing),
    "nothing_falls": ("bow", program._TrajectoryWriter, "_switch", never_on),
    "nobody_is_asked": ("bent", program._TrajectoryWriter, "_ask", do_nothing),
    "no_time_to_heat": ("bow", program._TrajectoryWriter, "_action", other_wait),
    "one_arm_of_two": ("bent", program._TrajectoryWriter, "_move", only_the_first),
    "names_without_prefix": (
        "bent",
        program,
        "joint_names",
        change_result(lambda names: [n[-7:] for n in names]),
    ),
    "base_elsewhere": ("bent", rows, "pose", lambda old: lambda pose: old(pose @ pose)),
    "wrong_count": ("bow", rows, "seal_rows", lambda old: lambda lines: old(lines[:-1])),
}


@pytest.mark.parametrize("name", FAULTS)
def test_no_fault_gets_a_file_proven(name, monkeypatch):
    job, owner, what, fault = FAULTS[name]
    problem, claims, plan = (make() for make in JOBS[job])
    clean = driven_job.bow_programs() if job == "bow" else driven_job.bent_programs()
    monkeypatch.setattr(owner, what, fault(getattr(owner, what)))
    try:
        programs = write.program_files(plan, problem)
    except (TandemError, straight_segments.PathNotKeptError):
        return  # it is refused, which is no proof
    assert programs != clean
    assert not Prover(problem, claims).prove(programs, first_error=True).ok
