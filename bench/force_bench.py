"""Force control of a support, compensation of a former, over random machines and beside a thesis' figures.

Overshoot, the law of error, force kept, deflection that is left, both loops at once. Rows are figures and not
times; the ratio is that of the figure to its maximum target.
"""

from __future__ import annotations

import itertools
import time
from typing import Any

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.loops.force_control import (
    ForceControl,
    ForceSensor,
    FormingMachine,
    ServoAxis,
    remaining_deflection,
    simulate_force,
    step_response,
)

MACHINES = 200
GAP_SPEED = 0.25 * MM
"""Speed at which the gap changes [m/s]: 5 % of a feed of 5 mm/s."""
CORNER, CORNER_S = 0.1 * MM, 0.4
"""A corner of the path closes the gap by this distance [m] in this time [s]."""
GOAL_OVERSHOOT, GOAL_LAW, GOAL_FORCE, GOAL_LEFT = 0.05, 0.15, 10.0, 0.05
SERVOS = ((18.0, 0.0), (18.0, 0.02), (18.0, 0.05), (4.9, 0.05), (4.9, 0.1))
"""Servos (bandwidth [Hz] at -3 dB, transport delay [s]) whose force is reported."""


def run() -> list[dict[str, Any]]:
    """Return rows of each figure over its target, with processor time in the note."""
    rows = [_overshoot(), _law(), _kept(), *_servos(), _left(), *_both()]
    return [row for row in rows if row]


def random_machines(count: int, seed: int) -> list[FormingMachine]:
    """Machines with arms of 200 to 1,000 N/mm, servos of one to four poles and 3 to 40 Hz, delays of up to
    100 ms, metal of 300 to 30,000 N/mm, filters of 15 to 100 Hz."""
    rng = np.random.default_rng(seed)

    def axis() -> ServoAxis:
        order = int(rng.integers(1, 5))
        return ServoAxis(rng.uniform(2e5, 1e6), rng.uniform(3.0, 40.0), order, rng.uniform(0.0, 0.1))

    return [
        FormingMachine(
            axis(), axis(), 10.0 ** rng.uniform(5.5, 7.5), ForceSensor(0.004, rng.uniform(15.0, 100.0))
        )
        for _ in range(count)
    ]


def _still(clock: FloatArray) -> FloatArray:
    return np.zeros_like(clock)


def _stepped(clock: FloatArray) -> FloatArray:
    return np.where(clock < 0.02, 200.0, 300.0)


def _at_200(clock: FloatArray) -> FloatArray:
    return np.full_like(clock, 200.0)


def _overshoot() -> dict[str, Any]:
    began = time.process_time()
    machines = random_machines(MACHINES, 1)
    trace = simulate_force(
        machines, [ForceControl(machine.recommended_gain()) for machine in machines], _stepped, _still, 4.0
    )
    result = step_response(trace, 200.0, 300.0)
    note = f"{np.count_nonzero(result.has_settled)} settle, 90 % in {np.median(result.rise):.2f} s (median)"
    name = f"largest overshoot of {MACHINES} random machines with Ki = 0.4 / (T Kc)"
    return _row(name, float(result.overshoot.max()), GOAL_OVERSHOOT, note, began)


def _law() -> dict[str, Any]:
    began = time.process_time()
    machines = random_machines(MACHINES, 2)
    controls = [ForceControl(item.recommended_gain()) for item in machines]
    trace = simulate_force(machines, controls, _at_200, lambda clock: GAP_SPEED * clock, 4.0)
    error = trace.force[:, -1] - 200.0
    deviation = np.abs(error / (GAP_SPEED / np.array([item.gain for item in controls])) - 1.0)
    note = f"errors of {error.min():.1f} to {error.max():.1f} N at 0.25 mm/s"
    return _row("error in motion off v / Ki, largest share", float(deviation.max()), GOAL_LAW, note, began)


def _kept() -> dict[str, Any]:
    """The dissertation's machine: 30 Hz, 440 Hz, 40 Hz filter, 12 bit (1 N), noise 1 %."""
    began = time.process_time()
    machine = FormingMachine(
        ServoAxis(5e5, 30.0), ServoAxis(5e5, 30.0), 5e6, ForceSensor(1.0 / 440.0, 40.0, 2.0, 1.0)
    )
    force = _largest(machine, ForceControl(machine.recommended_gain()))
    alone = _largest(machine, ForceControl(0.0))
    note = f"{alone:.0f} N under position control; the dissertation: 10 and 80 N"
    return _row("force off at 30 Hz and 440 Hz, N", force, GOAL_FORCE, note, began)


def _servos() -> list[dict[str, Any]]:
    """Report what servos over a controller's interface keep; no target is set."""
    out = []
    for bandwidth, delay in SERVOS:
        began = time.process_time()
        axis = ServoAxis(5e5, bandwidth, 3, delay)
        machine = FormingMachine(axis, axis, 5e6, ForceSensor(noise=3.0, quantum=1.0))
        gain = machine.recommended_gain()
        law = GAP_SPEED / gain
        feed = GOAL_FORCE * gain / 0.05
        late = 1e3 * machine.dead_time(axis)
        note = f"T {late:.0f} ms, v / Ki {law:.1f} N; 10 N are kept up to a feed of {feed / MM:.1f} mm/s"
        name = f"force off, servo of {bandwidth:g} Hz, {1e3 * delay:g} ms late, N"
        out.append(_row(name, _largest(machine, ForceControl(gain)), None, note, began))
    return out


def _largest(machine: FormingMachine, control: ForceControl) -> float:
    """The largest force off 200 N [N] while the gap changes, with a corner in it."""

    def gap(clock: FloatArray) -> FloatArray:
        return np.asarray(GAP_SPEED * clock + CORNER * np.clip((clock - 5.0) / CORNER_S, 0.0, 1.0))

    trace = simulate_force([machine], [control], _at_200, gap, 10.0, seed=3)
    return float(np.abs(trace.force - 200.0).max())


def _with_ratio(ratio: float, bandwidth: float, delay: float) -> FormingMachine:
    """A machine whose contact is so stiff, as a share of its former."""
    former = 5e5
    rest = 2.0 / (1.0 / (ratio * former) - 1.0 / former)
    return FormingMachine(ServoAxis(former, bandwidth, 3, delay), ServoAxis(rest, bandwidth, 3, delay), rest)


def _left() -> dict[str, Any]:
    began = time.process_time()
    ratios, shares, delays = (0.1, 0.3, 0.5, 0.7, 0.9), (0.8, 0.9, 0.95, 1.0), (0.0, 0.05, 0.1)
    cases = list(itertools.product(ratios, shares, delays))
    machines = [_with_ratio(ratio, 18.0, delay) for ratio, _, delay in cases]
    controls = [ForceControl(0.0, fraction) for _, fraction, _ in cases]
    push = 1.0 * MM
    trace = simulate_force(machines, controls, _still, lambda clock: np.where(clock < 0.1, 0.0, push), 25.0)
    alone = np.array([machine.contact * push / machine.former.stiffness for machine in machines])
    expected = np.array([float(remaining_deflection(fraction, ratio)) for ratio, fraction, _ in cases])
    deviation = np.abs(trace.deflection[:, -1] / alone - expected)
    note = f"of what is left without compensation; {len(cases)} cases, r 0.1 to 0.9, l 0.8 to 1, 0 to 100 ms"
    return _row("deflection left off (1 - l) / (1 - l r)", float(deviation.max()), GOAL_LEFT, note, began)


def _both() -> list[dict[str, Any]]:
    """Both loops in one run, r up to 0.9: overshoot and how many settle."""
    began = time.process_time()
    rng = np.random.default_rng(4)
    machines = [
        _with_ratio(rng.uniform(0.05, 0.9), rng.uniform(3.0, 40.0), rng.uniform(0.0, 0.1))
        for _ in range(MACHINES)
    ]
    shares = rng.uniform(0.5, 1.0, MACHINES)
    controls = [
        ForceControl(machine.recommended_gain(fraction), fraction)
        for machine, fraction in zip(machines, shares, strict=True)
    ]
    result = step_response(simulate_force(machines, controls, _stepped, _still, 30.0), 200.0, 300.0)
    loose = MACHINES - np.count_nonzero(result.has_settled)
    note = f"{MACHINES} random machines, r 0.05 to 0.9, l 0.5 to 1"
    return [
        _row(
            "both loops at once: largest overshoot",
            float(result.overshoot.max()),
            GOAL_OVERSHOOT,
            note,
            began,
        ),
        _row("both loops at once: machines that do not settle", float(loose), 0.0, note, began),
    ]


def _row(name: str, value: float, goal: float | None, note: str, began: float) -> dict[str, Any]:
    spent = time.process_time() - began
    expected = "" if goal is None else f"; wanted {goal:g} at most"
    ratio = None if goal is None else value / goal if goal > 0.0 else float(value > 0.0)
    return {"name": name, "median_s": value, "ratio": ratio, "note": f"{note}{expected}; {spent:.1f} s"}
