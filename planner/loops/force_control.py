"""Explicit force control of a support, and compensation of the forming arm's deflection, in the time domain.

All motion is along the line of centres of both tools. P is the path of the support away from the sheet, P_f
that of the forming arm into it. The sheet's forming force acts in parallel. (Source: a dissertation on
double-sided forming, section 2.3, where the sign of the support's move is printed reversed.)

    F = Kc (eps - P), but at least 0;  1 / Kc = 1 / k_f + 1 / k_metal + 1 / k_s
    eps = P_f + thickness - F_sheet / k_f
    dP/dt = -Ki (F_c - F)                    force control: the support approaches if the force is too small
    P_f = required + fraction * F / k_f      compensation of the forming arm, by the measured force

F_c is the commanded force. Each command passes a transport delay and a servo with a number of equal poles.
The force is measured each cycle, with noise, a first-order filter and the quantisation of a converter.

**Gain.** The lags of the loop act like one dead time T: delay, cycle, poles and filter. An integral loop with
a dead time oscillates from Ki Kc T = pi / 2 (the phase of e^(-i w T) / (i w) is -pi at w = pi / (2 T)), and
overshoots by about 5 % at 0.5. Hence Ki = 0.4 / (T Kc). A gap that changes at v_n is followed with an error
of v_n / Ki, because the integral of the error produces the speed.

**Compensation** is positive feedback with loop gain r = Kc / k_f. Of the deflection without it,
(1 - fraction) / (1 - fraction r) remains (F = Kc (d + fraction F / k_f) for a step d). It requires r < 1.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray

RECOMMENDED_GAIN: Final = 0.4
"""Recommended value of Ki Kc T [-]."""
MAX_GAIN: Final = 0.5 * np.pi
"""Value of Ki Kc T at which a loop with a dead time T starts to oscillate [-]."""
STEPS_PER_CYCLE: Final = 8
"""Number of time steps of the servos in a cycle of the controller."""
SETTLED_FRACTION: Final = 0.02
"""Maximum deviation from the final value, as a fraction of the step, of a response that has settled."""


@dataclasses.dataclass(frozen=True)
class ServoAxis:
    """Motion of an arm with its tool along the line of centres.

    Attributes:
        stiffness: Stiffness of arm and tool [N/m].
        bandwidth: Bandwidth of the servo at a gain of 0.71 (-3 dB) [Hz].
        order: Number of equal poles of the servo.
        delay: Transport delay of its commands [s].
    """

    stiffness: float
    bandwidth: float
    order: int = 3
    delay: float = 0.0

    @property
    def pole(self) -> float:
        """Frequency w of each pole [rad/s].

        At the bandwidth f the gain is (1 / sqrt(1 + (2 pi f / w)^2))^order = 1 / sqrt 2.
        """
        return float(2.0 * np.pi * self.bandwidth / np.sqrt(2.0 ** (1.0 / self.order) - 1.0))


@dataclasses.dataclass(frozen=True)
class ForceSensor:
    """Measurement of the force.

    Attributes:
        cycle: Cycle time [s].
        filter_hz: Bandwidth of the first-order filter, at -3 dB [Hz].
        noise: Standard deviation of the noise [N].
        quantum: Step of the converter [N], 0 for none.
    """

    cycle: float = 0.004
    filter_hz: float = 40.0
    noise: float = 0.0
    quantum: float = 0.0


@dataclasses.dataclass(frozen=True)
class FormingMachine:
    """Both arms, the metal between them and the force sensor.

    Attributes:
        forming: Arm that forms the sheet.
        support: Arm that supports the sheet from the other side.
        metal: Stiffness of the metal between both tools [N/m].
        sensor: The force sensor.
    """

    forming: ServoAxis
    support: ServoAxis
    metal: float
    sensor: ForceSensor = ForceSensor()

    @property
    def contact(self) -> float:
        """Stiffness Kc [N/m] of forming arm, metal and support in series."""
        return 1.0 / (1.0 / self.forming.stiffness + 1.0 / self.metal + 1.0 / self.support.stiffness)

    @property
    def compliance_gain(self) -> float:
        """Loop gain r [-] of the compensation of the forming arm."""
        return self.contact / self.forming.stiffness

    def dead_time(self, axis: ServoAxis) -> float:
        """Return the dead time T [s] that replaces all lags of a force loop over an axis.

        The recommended and the maximum gain follow from it. It is the sum of the delay of the axis, 1.5
        cycles, the lag of each of the ``order`` poles of the axis, and the lag of the sensor's filter. The
        computation of a command takes one cycle. The command is then held for one cycle, which is half a
        cycle of lag on average.
        """
        sensor = self.sensor
        # a first-order lag with the frequency w delays slow changes by 1 / w
        filter_lag = 1.0 / (2.0 * np.pi * sensor.filter_hz)
        return float(axis.delay + 1.5 * sensor.cycle + axis.order / axis.pole + filter_lag)

    def recommended_gain(self, fraction: float = 0.0) -> float:
        """Return the recommended integral gain Ki [m/(N s)] of the support's force.

        It is 0 if the compensation alone is unstable, with a loop gain of 1 or more.

        Args:
            fraction: Fraction of the forming arm's deflection that is compensated.
        """
        return RECOMMENDED_GAIN * self._gain_unit(fraction)

    def max_gain(self, fraction: float = 0.0) -> float:
        """Return the integral gain [m/(N s)] from which the loop with a compensated fraction is unstable."""
        return MAX_GAIN * self._gain_unit(fraction)

    def effective_contact(self, fraction: float) -> tuple[float, float]:
        """Return the stiffness [N/m] and dead time [s] of the contact that the support's loop sees.

        Args:
            fraction: Fraction of the forming arm's deflection that is compensated, with a loop gain below 1.
        """
        loop_gain = fraction * self.compliance_gain
        # with both loops the contact has the stiffness Kc / (1 - loop gain), and an additional lag
        dead_time = self.dead_time(self.support) + loop_gain / (1.0 - loop_gain) * self.dead_time(
            self.forming
        )
        return self.contact / (1.0 - loop_gain), dead_time

    def _gain_unit(self, fraction: float) -> float:
        """Return the gain Ki [m/(N s)] at which Ki Kc T is 1; 0 if the compensation alone is unstable."""
        if fraction * self.compliance_gain >= 1.0:
            return 0.0
        stiffness, dead_time = self.effective_contact(fraction)
        return 1.0 / (dead_time * stiffness)


@dataclasses.dataclass(frozen=True)
class ForceControl:
    """Settings of the controller.

    Attributes:
        gain: Integral gain Ki of the support's force [m/(N s)], 0 for position control.
        fraction: Fraction of the forming arm's deflection that is compensated [-].
    """

    gain: float
    fraction: float = 0.0


@dataclasses.dataclass(frozen=True)
class ForceTrace:
    """Result of a simulation of M machines over S samples, one in each cycle.

    Attributes:
        time: Time (S,) [s].
        force: Actual force (M, S) [N].
        measured: Measured force (M, S) [N].
        deflection: Remaining deflection of the forming arm (M, S) [m].
        support: Position of the support (M, S) [m].
        commanded: Commanded force (M, S) [N].
    """

    time: FloatArray
    force: FloatArray
    measured: FloatArray
    deflection: FloatArray
    support: FloatArray
    commanded: FloatArray


TimeFunction = Callable[[FloatArray], FloatArray]
"""A quantity of all machines, (S,) or (M, S), at times (S,) [s]."""


def simulate_force(
    machines: list[FormingMachine],
    controls: list[ForceControl],
    commanded: TimeFunction,
    gap: TimeFunction,
    seconds: float,
    seed: int = 0,
) -> ForceTrace:
    """Simulate the forces of M machines with force control over time.

    They start at rest, with the force that is commanded at time 0. Per cycle, the controller integrates the
    force error for the support and compensates the deflection of the forming arm. Within a cycle, both arms
    and the filter of the sensor are simulated in ``STEPS_PER_CYCLE`` steps.

    Args:
        machines: The machines. All sensors have the same cycle.
        controls: Settings of the controller of each machine.
        commanded: Commanded force F_c [N] as a function of time, evaluated at each cycle.
        gap: Path [m] by which the forming arm's command and the sheet approach each other, 0 at time 0. It is
            evaluated at each step.
        seconds: Duration [s].
        seed: Seed of the noise.

    Raises:
        ValueError: The cycles of the machines differ, or there is not one control for each machine.
    """
    cycles = {machine.sensor.cycle for machine in machines}
    if len(cycles) != 1 or len(machines) != len(controls):
        raise ValueError(
            f"machines of one run need the same cycle and one control each: got cycles {sorted(cycles)}"
        )
    cycle = cycles.pop()
    count, cycle_count = len(machines), round(seconds / cycle)
    time_step = cycle / STEPS_PER_CYCLE
    time: FloatArray = cycle * np.arange(cycle_count, dtype=np.float64)
    commanded_force = np.broadcast_to(commanded(time), (count, cycle_count))
    contact = np.array([machine.contact for machine in machines])
    forming_stiffness = np.array([machine.forming.stiffness for machine in machines])
    gain = np.array([control.gain for control in controls])
    compensation = np.array([control.fraction for control in controls]) / forming_stiffness
    sensors = [machine.sensor for machine in machines]
    noise = np.array([sensor.noise for sensor in sensors])[:, None] * np.random.default_rng(seed).normal(
        size=(count, cycle_count)
    )
    quantum = np.array([sensor.quantum for sensor in sensors])
    filter_factor = np.exp(-2.0 * np.pi * np.array([sensor.filter_hz for sensor in sensors]) * time_step)
    support_servos = _ServoChain([machine.support for machine in machines], time_step)
    forming_servos = _ServoChain([machine.forming for machine in machines], time_step)
    # at rest the support applies the commanded force, and the forming arm's deflection is compensated
    start = np.asarray(commanded_force[:, 0], dtype=np.float64)
    position, forming_command = -start / contact + compensation * start, compensation * start
    support_servos.reset(position)
    forming_servos.reset(forming_command)
    filtered = start
    out = np.empty((4, count, cycle_count))
    gap_path = gap(np.asarray(time_step * np.arange(cycle_count * STEPS_PER_CYCLE), dtype=np.float64))
    gap_path = np.broadcast_to(gap_path, (count, cycle_count * STEPS_PER_CYCLE))
    force = start
    for k in range(cycle_count):
        # 1e-300 avoids a division by 0 for sensors without quantisation, whose result is not used
        quantised = np.round(filtered / np.maximum(quantum, 1e-300)) * quantum
        measured = np.where(quantum > 0.0, quantised, filtered)
        # commands computed in this cycle are sent in the next
        sent_position, position = position, position - gain * cycle * (commanded_force[:, k] - measured)
        sent_forming = forming_command
        forming_command = np.where(compensation > 0.0, compensation * measured, forming_command)
        out[:, :, k] = force, measured, force / forming_stiffness - forming_servos.value, support_servos.value
        for step in range(STEPS_PER_CYCLE):
            support_position = support_servos.step(sent_position)
            forming_position = forming_servos.step(sent_forming)
            eps = forming_position + gap_path[:, k * STEPS_PER_CYCLE + step]
            # the contact only pushes; the filter gets the mean of the force over the step
            previous_force, force = force, np.maximum(contact * (eps - support_position), 0.0)
            filtered = filter_factor * filtered + (1.0 - filter_factor) * (
                0.5 * (previous_force + force) + noise[:, k]
            )
    return ForceTrace(time, out[0], out[1], out[2], out[3], commanded_force)


class _ServoChain:
    """Servos of M axes: delays and chains of equal poles, for commands that are held between time steps."""

    def __init__(self, axes: list[ServoAxis], step: float) -> None:
        self._order = np.array([axis.order for axis in axes])
        self._factor = np.exp(-np.array([axis.pole for axis in axes]) * step)
        self._delay_steps = np.array([round(axis.delay / step) for axis in axes])
        self._poles = np.zeros((int(self._order.max()), len(axes)))
        self._commands = np.zeros((int(self._delay_steps.max()) + 1, len(axes)))
        self._step_index = 0

    def reset(self, value: FloatArray) -> None:
        """Put the servos at rest at positions (M,) [m]."""
        self._poles[:] = value
        self._commands[:] = value

    @property
    def value(self) -> FloatArray:
        """Current positions (M,) [m]."""
        return np.asarray(self._poles[self._order - 1, np.arange(len(self._order))])

    def step(self, command: FloatArray) -> FloatArray:
        """Advance by one time step under commands (M,) [m], and return the new positions (M,) [m].

        A command first waits for the delay of its axis and then passes a first-order lag for each pole.
        """
        buffer_size = len(self._commands)  # the last commands, in a ring buffer
        self._commands[self._step_index % buffer_size] = command
        pole_input = self._commands[
            (self._step_index - self._delay_steps) % buffer_size, np.arange(len(self._delay_steps))
        ]
        self._step_index += 1
        for k in range(len(self._poles)):
            last_value = self._poles[k].copy()
            next_value = self._factor * last_value + (1.0 - self._factor) * pole_input
            self._poles[k] = next_value
            pole_input = 0.5 * (last_value + next_value)  # mean input of the next pole during the step
        return self.value


@dataclasses.dataclass(frozen=True)
class StepResponse:
    """Step responses of M machines.

    Attributes:
        overshoot: Overshoot as a fraction of the step, (M,) [-].
        rise: Time from the start of the run until 0.9 of the step is reached, inf if it is not, (M,) [s].
        has_settled: Whether the last fifth of the run stays within `SETTLED_FRACTION`, (M,).
    """

    overshoot: FloatArray
    rise: FloatArray
    has_settled: BoolArray


def step_response(trace: ForceTrace, start: float, end: float) -> StepResponse:
    """Return the step responses of a simulation whose commanded force steps at its start.

    Args:
        trace: Result of the simulation.
        start: Force before the step [N].
        end: Force after the step [N].
    """
    fraction = (trace.force - start) / (end - start)
    is_reached = fraction >= 0.9
    last_part = fraction[:, -(len(trace.time) // 5) :]
    return StepResponse(
        overshoot=np.maximum(fraction.max(axis=1) - 1.0, 0.0),
        rise=np.where(is_reached.any(axis=1), trace.time[is_reached.argmax(axis=1)], np.inf),
        has_settled=np.asarray(np.abs(last_part - 1.0).max(axis=1) <= SETTLED_FRACTION),
    )


def remaining_deflection(fraction: float | FloatArray, compliance_gain: float | FloatArray) -> FloatArray:
    """Return the fraction of the uncompensated deflection that remains: (1 - fraction) / (1 - fraction r).

    Args:
        fraction: Fraction of the deflection that is compensated [-].
        compliance_gain: Loop gain r of the compensation [-].
    """
    return np.asarray(
        (1.0 - np.asarray(fraction)) / (1.0 - np.asarray(fraction) * np.asarray(compliance_gain))
    )
