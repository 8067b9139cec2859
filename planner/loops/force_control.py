"""Explicit force control of a support, and compensation of a former that gives way, in time.

Along the line of centres, with P the way of the support off the sheet, P_f that of the former into it, and
the sheet's forming force beside (a dissertation on double-sided forming, section 2.3, whose sign of the
support's move is printed the other way round):

    F = Kc (eps - P), where positive;  1 / Kc = 1 / k_f + 1 / k_metal + 1 / k_s
    eps = P_f + thickness - F_sheet / k_f
    dP/dt = -Ki (F_c - F)                         force control: a push that is too weak draws nearer
    P_f = wanted + share * F / k_f                compensation of the former, by the measured force

Each command goes through a transport delay and a servo of so many equal poles; the force is measured each
cycle, with noise, a first-order filter and a converter's steps.

**Gain.** What the loop has of lags acts like one dead time T: delay, cycle, poles and filter. An integral
loop with a dead time oscillates from Ki Kc T = pi / 2 on (the phase of e^(-i w T) / (i w) is -pi at w = pi /
(2 T)), and overshoots by about 5 % at 0.5; so Ki = 0.4 / (T Kc). A gap that changes at v_n is followed with
an error of v_n / Ki: the integral of the error makes the speed.

**Compensation** is positive feedback of loop gain r = Kc / k_f: of the deflection without it,
(1 - share) / (1 - share r) stays (F = Kc (d + share F / k_f) for a step d). It wants r < 1.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray

GAIN: Final = 0.4
"""Ki Kc T that is recommended [-]."""
MOST_GAIN: Final = 0.5 * np.pi
"""Ki Kc T from which a loop with a dead time T oscillates [-]."""
STEPS_A_CYCLE: Final = 8
"""Steps of time in a cycle of the controller, in which servos go on."""
SETTLED_SHARE: Final = 0.02
"""A response has settled where it stays so near to its end, as a share of its way."""


@dataclasses.dataclass(frozen=True)
class Axis:
    """An arm along the line of centres: ``stiffness`` [N/m] with its tool, servo of ``order`` equal poles
    that lets ``bandwidth`` [Hz] through by 0.71 (-3 dB), transport ``delay`` [s] of its commands."""

    stiffness: float
    bandwidth: float
    order: int = 3
    delay: float = 0.0

    @property
    def pole(self) -> float:
        """Each pole [rad/s]: w of (1 / sqrt(1 + (2 pi f / w)^2))^order = 1 / sqrt 2 at the bandwidth f."""
        return float(2.0 * np.pi * self.bandwidth / np.sqrt(2.0 ** (1.0 / self.order) - 1.0))


@dataclasses.dataclass(frozen=True)
class Sensor:
    """How force is measured: each ``cycle`` [s], through a first-order filter of ``filter_hz`` (-3 dB), with
    ``noise`` [N] (one standard deviation) and a converter's steps of ``quantum`` [N], 0 for none."""

    cycle: float = 0.004
    filter_hz: float = 40.0
    noise: float = 0.0
    quantum: float = 0.0


@dataclasses.dataclass(frozen=True)
class Machine:
    """Both arms, the metal between them (``metal`` [N/m]) and the force sensor."""

    former: Axis
    support: Axis
    metal: float
    sensor: Sensor = Sensor()

    @property
    def contact(self) -> float:
        """Stiffness Kc [N/m] of former, metal and support in a row."""
        return 1.0 / (1.0 / self.former.stiffness + 1.0 / self.metal + 1.0 / self.support.stiffness)

    @property
    def compliance_gain(self) -> float:
        """Loop gain r [-] of the compensation of the former."""
        return self.contact / self.former.stiffness

    def dead_time(self, axis: Axis) -> float:
        """What a loop over an axis has of lags, as one dead time T [s]: a command takes a cycle to be worked
        out and holds for another, which is half a cycle's lag."""
        sensor = self.sensor
        filtered = 1.0 / (2.0 * np.pi * sensor.filter_hz)
        return float(axis.delay + 1.5 * sensor.cycle + axis.order / axis.pole + filtered)

    def gain(self, share: float = 0.0) -> float:
        """Recommended integral gain Ki [m/(N s)] of the support's force, where ``share`` of the former's
        deflection is compensated; 0 where that leaves the loop nothing."""
        return GAIN * self._per_gain(share)

    def most_gain(self, share: float = 0.0) -> float:
        """Integral gain [m/(N s)] from which the loop counts as unstable."""
        return MOST_GAIN * self._per_gain(share)

    def felt(self, share: float) -> tuple[float, float]:
        """Stiffness [N/m] and dead time [s] of the contact as the support's loop feels it, beside which a
        ``share`` of the former's deflection is compensated; a loop gain of that below 1."""
        back = share * self.compliance_gain
        # with both loops the contact is as stiff as Kc / (1 - back), and gets so with a lag of its own
        late = self.dead_time(self.support) + back / (1.0 - back) * self.dead_time(self.former)
        return self.contact / (1.0 - back), late

    def _per_gain(self, share: float) -> float:
        if share * self.compliance_gain >= 1.0:
            return 0.0
        stiff, late = self.felt(share)
        return 1.0 / (late * stiff)


@dataclasses.dataclass(frozen=True)
class Control:
    """What the controller does: integral ``gain`` Ki [m/(N s)] of the support's force, 0 for position
    control; ``share`` of the former's deflection that is compensated [-]."""

    gain: float
    share: float = 0.0


@dataclasses.dataclass(frozen=True)
class Trace:
    """A run of M machines over S samples, one each cycle: ``time`` (S,) [s], ``force`` (M, S) [N] as it is,
    ``measured`` (M, S) [N], ``deflection`` (M, S) [m] that is left at the former, ``support`` (M, S) [m],
    ``wanted`` (M, S) [N] the force that is commanded."""

    time: FloatArray
    force: FloatArray
    measured: FloatArray
    deflection: FloatArray
    support: FloatArray
    wanted: FloatArray


Drive = Callable[[FloatArray], FloatArray]
"""A quantity of all machines, (S,) or (M, S), at times (S,) [s]."""


def simulate(
    machines: list[Machine], controls: list[Control], wanted: Drive, gap: Drive, seconds: float, seed: int = 0
) -> Trace:
    """Run M machines from rest at the ``wanted`` force at time 0.

    ``wanted``: force F_c [N]; ``gap``: way [m] that the former's command and the sheet close in by, which is
    0 at time 0. All machines have sensors of one cycle. Raises ``ValueError`` where they do not."""
    cycles = {machine.sensor.cycle for machine in machines}
    if len(cycles) != 1 or len(machines) != len(controls):
        raise ValueError(
            f"machines of one run need one cycle each, and a control: got cycles {sorted(cycles)}"
        )
    cycle = cycles.pop()
    count, steps = len(machines), round(seconds / cycle)
    fine = cycle / STEPS_A_CYCLE
    time: FloatArray = cycle * np.arange(steps, dtype=np.float64)
    force_c = np.broadcast_to(wanted(time), (count, steps))
    contact = np.array([machine.contact for machine in machines])
    former = np.array([machine.former.stiffness for machine in machines])
    gain = np.array([control.gain for control in controls])
    back = np.array([control.share for control in controls]) / former
    sensors = [machine.sensor for machine in machines]
    noise = np.array([sensor.noise for sensor in sensors])[:, None] * np.random.default_rng(seed).normal(
        size=(count, steps)
    )
    quantum = np.array([sensor.quantum for sensor in sensors])
    keep = np.exp(-2.0 * np.pi * np.array([sensor.filter_hz for sensor in sensors]) * fine)
    support = _Servos([machine.support for machine in machines], fine)
    aside = _Servos([machine.former for machine in machines], fine)
    # at rest the support presses with the wanted force, and what the former gives way by is compensated
    start = np.asarray(force_c[:, 0], dtype=np.float64)
    p, lift = -start / contact + back * start, back * start
    support.rest(p)
    aside.rest(lift)
    filtered = start
    out = np.empty((4, count, steps))
    ways = gap(np.asarray(fine * np.arange(steps * STEPS_A_CYCLE), dtype=np.float64))
    ways = np.broadcast_to(ways, (count, steps * STEPS_A_CYCLE))
    force = start
    for k in range(steps):
        steps_of = np.round(filtered / np.maximum(quantum, 1e-300)) * quantum
        measured = np.where(quantum > 0.0, steps_of, filtered)
        # what is worked out in this cycle goes out in the next
        sent, p = p, p - gain * cycle * (force_c[:, k] - measured)
        given, lift = lift, np.where(back > 0.0, back * measured, lift)
        out[:, :, k] = force, measured, force / former - aside.value, support.value
        for step in range(STEPS_A_CYCLE):
            at_support, at_former = support.step(sent), aside.step(given)
            eps = at_former + ways[:, k * STEPS_A_CYCLE + step]
            before, force = force, np.maximum(contact * (eps - at_support), 0.0)
            filtered = keep * filtered + (1.0 - keep) * (0.5 * (before + force) + noise[:, k])
    return Trace(time, out[0], out[1], out[2], out[3], force_c)


class _Servos:
    """Servos of M axes: chains of equal poles behind delays, for commands that are held between steps."""

    def __init__(self, axes: list[Axis], step: float) -> None:
        self._order = np.array([axis.order for axis in axes])
        self._share = np.exp(-np.array([axis.pole for axis in axes]) * step)
        self._late = np.array([round(axis.delay / step) for axis in axes])
        self._poles = np.zeros((int(self._order.max()), len(axes)))
        self._past = np.zeros((int(self._late.max()) + 1, len(axes)))
        self._now = 0

    def rest(self, value: FloatArray) -> None:
        """Stand still at (M,) values."""
        self._poles[:] = value
        self._past[:] = value

    @property
    def value(self) -> FloatArray:
        """Where they are (M,)."""
        return np.asarray(self._poles[self._order - 1, np.arange(len(self._order))])

    def step(self, command: FloatArray) -> FloatArray:
        """Where they are (M,) a step later, under commands (M,)."""
        rows = len(self._past)
        self._past[self._now % rows] = command
        into = self._past[(self._now - self._late) % rows, np.arange(len(self._late))]
        self._now += 1
        for k in range(len(self._poles)):
            before = self._poles[k].copy()
            after = self._share * before + (1.0 - self._share) * into
            self._poles[k] = after
            into = 0.5 * (before + after)  # what the next pole gets on the way
        return self.value


@dataclasses.dataclass(frozen=True)
class Response:
    """Of M responses from ``start`` to an end: ``overshoot`` (M,) as a share of the way, ``rise`` (M,) [s] to
    0.9 of it, ``settled`` (M,) whether the last fifth stays within `SETTLED_SHARE`."""

    overshoot: FloatArray
    rise: FloatArray
    settled: BoolArray


def step_response(trace: Trace, start: float, end: float) -> Response:
    """Of a run whose wanted force steps from ``start`` to ``end`` [N] at its beginning."""
    share = (trace.force - start) / (end - start)
    reached = share >= 0.9
    late = share[:, -(len(trace.time) // 5) :]
    return Response(
        overshoot=np.maximum(share.max(axis=1) - 1.0, 0.0),
        rise=np.where(reached.any(axis=1), trace.time[reached.argmax(axis=1)], np.inf),
        settled=np.asarray(np.abs(late - 1.0).max(axis=1) <= SETTLED_SHARE),
    )


def left_over(share: float | FloatArray, compliance_gain: float | FloatArray) -> FloatArray:
    """Share of the uncompensated deflection that stays where ``share`` of it is compensated [-]."""
    return np.asarray((1.0 - np.asarray(share)) / (1.0 - np.asarray(share) * np.asarray(compliance_gain)))
