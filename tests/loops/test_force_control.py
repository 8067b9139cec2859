"""Force control and compensation in time, against closed forms and data of published machines."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import brentq

from planner.geometry.arrays import FloatArray
from planner.loops.force_control import (
    ForceControl,
    ForceSensor,
    FormingMachine,
    ServoAxis,
    remaining_deflection,
    simulate_force,
    step_response,
)


def still(time: FloatArray) -> FloatArray:
    return np.zeros_like(time)


def at_200(time: FloatArray) -> FloatArray:
    return np.full_like(time, 200.0)


def stepped(time: FloatArray) -> FloatArray:
    return np.where(time < 0.02, 200.0, 300.0)


def random_machines(count: int, seed: int) -> list[FormingMachine]:
    rng = np.random.default_rng(seed)

    def axis() -> ServoAxis:
        stiffness, bandwidth = rng.uniform(2e5, 1e6), rng.uniform(3.0, 40.0)
        return ServoAxis(stiffness, bandwidth, int(rng.integers(1, 5)), rng.uniform(0.0, 0.1))

    return [
        FormingMachine(
            axis(), axis(), 10.0 ** rng.uniform(5.5, 7.5), ForceSensor(0.004, rng.uniform(15.0, 100.0))
        )
        for _ in range(count)
    ]


def with_ratio(ratio: float, bandwidth: float, delay: float) -> FormingMachine:
    """A machine whose contact is so stiff, as a share of its former."""
    former = 5e5
    rest = 2.0 / (1.0 / (ratio * former) - 1.0 / former)
    axis = ServoAxis(former, bandwidth, 3, delay)
    return FormingMachine(axis, ServoAxis(rest, bandwidth, 3, delay), rest)


def test_the_bandwidth_is_where_a_servo_lets_through_half_the_power() -> None:
    axis = ServoAxis(5e5, 18.0)
    through = 1.0 / abs(1.0 + 2j * np.pi * 18.0 / axis.pole) ** 3
    assert through == pytest.approx(np.sqrt(0.5))


def test_springs_in_a_row() -> None:
    machine = FormingMachine(ServoAxis(5e5, 18.0), ServoAxis(1e6, 18.0), 1e6)
    assert machine.contact == pytest.approx(2.5e5)
    assert machine.compliance_gain == pytest.approx(0.5)


def test_no_recommended_gain_overshoots_by_more_than_5_percent() -> None:
    machines = random_machines(200, 1)
    controls = [ForceControl(machine.recommended_gain()) for machine in machines]
    found = step_response(simulate_force(machines, controls, stepped, still, 4.0), 200.0, 300.0)
    assert found.overshoot.max() <= 0.05
    assert found.has_settled.all()


def test_a_gap_that_changes_is_followed_with_an_error_of_its_speed_over_the_gain() -> None:
    machines, speed = random_machines(50, 2), 0.25e-3
    controls = [ForceControl(machine.recommended_gain()) for machine in machines]
    run = simulate_force(machines, controls, at_200, lambda time: speed * time, 4.0)
    law = np.array([speed / control.gain for control in controls])
    assert run.force[:, -1] - 200.0 == pytest.approx(law, rel=0.01)


@pytest.mark.parametrize(("bandwidth", "delay"), [(18.0, 0.0), (18.0, 0.02), (18.0, 0.05), (4.9, 0.1)])
def test_the_gain_that_oscillates_is_that_of_the_loop_s_phase(bandwidth: float, delay: float) -> None:
    """Phase and amplitude of integral, poles, filter and delay (one cycle to work out, half of one by
    holding) at the frequency where they add up to half a turn."""
    machine = FormingMachine(ServoAxis(5e5, bandwidth, 3, delay), ServoAxis(5e5, bandwidth, 3, delay), 5e6)
    pole, low = machine.support.pole, 2.0 * np.pi * machine.sensor.filter_hz
    late = delay + 1.5 * machine.sensor.cycle

    def beyond(w: float) -> float:
        return float(0.5 * np.pi + 3.0 * np.arctan(w / pole) + np.arctan(w / low) + w * late - np.pi)

    w = brentq(beyond, 1.0, 1000.0)
    critical = w * (1.0 + (w / pole) ** 2) ** 1.5 * np.sqrt(1.0 + (w / low) ** 2) / machine.contact
    assert machine.max_gain() <= critical  # the rule is on the safe side of it
    dead = machine.dead_time(machine.support)

    def swings(gain: float) -> FloatArray:
        run = simulate_force(
            [machine], [ForceControl(gain)], lambda t: np.where(t < 0.02, 200.0, 201.0), still, 60 * dead
        )
        off = np.abs(run.force[0] - 201.0)
        return np.array([off[len(off) // 3 : len(off) // 2].max(), off[-len(off) // 6 :].max()])

    before, after = swings(0.85 * critical)
    assert after < before
    before, after = swings(1.2 * critical)
    assert after > before


def test_what_compensation_leaves_of_a_deflection() -> None:
    """(1 - l) / (1 - l r), whatever the delay."""
    cases = list(itertools.product((0.1, 0.5, 0.9), (0.8, 0.9, 1.0), (0.0, 0.1)))
    machines = [with_ratio(ratio, 18.0, delay) for ratio, _, delay in cases]
    controls = [ForceControl(0.0, fraction) for _, fraction, _ in cases]
    run = simulate_force(machines, controls, still, lambda t: np.where(t < 0.1, 0.0, 1e-3), 20.0)
    alone = [machine.contact * 1e-3 / machine.forming.stiffness for machine in machines]
    left = np.array([(1.0 - fraction) / (1.0 - fraction * ratio) for ratio, fraction, _ in cases])
    assert run.deflection[:, -1] / alone == pytest.approx(left, abs=0.01)
    assert [float(remaining_deflection(fraction, ratio)) for ratio, fraction, _ in cases] == pytest.approx(
        list(left)
    )


def test_compensation_runs_away_where_the_contact_is_as_stiff_as_the_former() -> None:
    machine = with_ratio(0.9, 18.0, 0.1)
    run = simulate_force(
        [machine], [ForceControl(0.0, 1.05 / 0.9)], still, lambda t: np.where(t < 0.1, 0.0, 1e-5), 20.0
    )
    assert run.force[0, -1] > 10.0 * machine.contact * 1e-5
    assert machine.recommended_gain(1.05 / 0.9) == 0.0


def test_both_loops_at_once_settle() -> None:
    rng = np.random.default_rng(4)
    machines = [
        with_ratio(rng.uniform(0.05, 0.9), rng.uniform(3.0, 40.0), rng.uniform(0.0, 0.1)) for _ in range(100)
    ]
    controls = [
        ForceControl(machine.recommended_gain(fraction), fraction)
        for machine, fraction in zip(machines, rng.uniform(0.5, 1.0, 100), strict=True)
    ]
    found = step_response(simulate_force(machines, controls, stepped, still, 30.0), 200.0, 300.0)
    assert found.has_settled.all()
    assert found.overshoot.max() <= 0.05


def test_a_machine_of_30_hz_keeps_its_force_within_10_newtons() -> None:
    """The dissertation on double-sided forming, section 2.4.2: +- 10 N with a servo of 30 Hz and a force loop
    of 440 Hz, 40 Hz filter, 1 N steps, 1 % noise; a gap that changes by 5 % of 5 mm/s, and a corner."""
    machine = FormingMachine(
        ServoAxis(5e5, 30.0), ServoAxis(5e5, 30.0), 5e6, ForceSensor(1.0 / 440.0, 40.0, 2.0, 1.0)
    )

    def gap(time: FloatArray) -> FloatArray:
        return 0.25e-3 * time + 0.1e-3 * np.clip((time - 5.0) / 0.4, 0.0, 1.0)

    machines, controls = [machine, machine], [ForceControl(machine.recommended_gain()), ForceControl(0.0)]
    run = simulate_force(machines, controls, at_200, gap, 10.0, seed=3)
    kept, alone = np.abs(run.force - 200.0).max(axis=1)
    assert kept <= 10.0
    assert alone > 200.0


def test_the_same_seed_gives_the_same_run_and_cycles_must_agree() -> None:
    machine = FormingMachine(ServoAxis(5e5, 18.0), ServoAxis(5e5, 18.0), 5e6, ForceSensor(noise=3.0))
    control = ForceControl(machine.recommended_gain())
    one, two = (simulate_force([machine], [control], at_200, still, 1.0, seed=5) for _ in range(2))
    assert np.array_equal(one.force, two.force)
    other = FormingMachine(machine.forming, machine.support, machine.metal, ForceSensor(cycle=0.012))
    with pytest.raises(ValueError, match="same cycle"):
        simulate_force([machine, other], [control] * 2, at_200, still, 1.0)
