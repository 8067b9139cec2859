"""A machine that forms with force control: its file, the gains it gets, and what they keep.

Stiffness, bandwidth and delay of arms are the user's: no robot of the catalogue states them, so nothing is
claimed without this file.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from planner.geometry.units import MM
from planner.issues import Issue, Severity, TandemError
from planner.loops.force_control import (
    Axis,
    Control,
    Machine,
    Response,
    Sensor,
    Trace,
    left_over,
    simulate,
    step_response,
)
from planner.reading import strict_yaml
from planner.reading.strict_yaml import Name, Positive, Strict

INTERFACES: Final = {
    "egm": "Externally Guided Motion: position guidance (EGMRunPose) each 4 ms, its lag measured on the arm; "
    "set the correction's limits with EGMSetupUC and EGMActPose",
    "rsi": "RobotSensorInterface: path corrections each 4 or 12 ms (RSI context with POSCORR); set the "
    "limits of POSCORR, by default 5 mm, and ST_ON in relative mode",
}
"""What has to be set for each way into a controller."""
RUN_SECONDS: Final = 60.0
"""Length of simulated responses in dead times is at most this [s]."""


class AxisFile(Strict):
    """An arm with its tool along the line of centres."""

    stiffness_n_mm: Annotated[Positive, Field(description="of arm and tool, measured")]
    bandwidth_hz: Annotated[float, Field(gt=0.1, le=1000, description="of its motion, at -3 dB")]
    poles: Annotated[int, Field(ge=1, le=6, description="of its servo")] = 3
    delay_ms: Annotated[float, Field(ge=0, le=1000, description="until the arm begins to move")] = 0.0

    def value(self) -> Axis:
        """In SI units."""
        return Axis(self.stiffness_n_mm / MM, self.bandwidth_hz, self.poles, self.delay_ms / 1000.0)


class SensorFile(Strict):
    """The force sensor and its cycle."""

    cycle_ms: Annotated[float, Field(gt=0.1, le=100)] = 4.0
    filter_hz: Annotated[float, Field(gt=0.1, le=10_000, description="first-order, at -3 dB")] = 40.0
    noise_n: Annotated[float, Field(ge=0, le=1000, description="one standard deviation")] = 0.0
    step_n: Annotated[float, Field(ge=0, le=100, description="of the converter")] = 0.0

    def value(self) -> Sensor:
        """In SI units."""
        return Sensor(self.cycle_ms / 1000.0, self.filter_hz, self.noise_n, self.step_n)


class MachineFile(Strict):
    """A machine: both arms, the metal between them, the sensor, and what is wanted of it."""

    tandem_machine: Literal[1]
    name: Name = "machine"
    former: AxisFile
    support: AxisFile
    metal_n_mm: Annotated[Positive, Field(description="stiffness of the sheet between both tools")]
    sensor: SensorFile = SensorFile()
    force_n: Annotated[float, Field(gt=0, le=100_000, description="that the support shall press with")]
    band_n: Annotated[float, Field(gt=0, le=10_000, description="how far the force may be off")] = 10.0
    gap_change: Annotated[
        float, Field(ge=0, le=1, description="speed at which the gap changes, over the feed")
    ] = 0.05
    compensate: Annotated[float, Field(ge=0, le=1.5, description="share of the former's deflection")] = 0.0
    gain_um_ns: Annotated[
        float | None, Field(gt=0, description="integral gain [um/(N s)]; none: the recommended one")
    ] = None
    interface: Literal["egm", "rsi"] | None = None
    correction_mm: Annotated[float, Field(gt=0, le=100, description="largest correction allowed")] = 5.0

    def value(self) -> Machine:
        """In SI units."""
        return Machine(self.former.value(), self.support.value(), self.metal_n_mm / MM, self.sensor.value())


def read_machine(path: Path) -> MachineFile:
    """The machine of a file. Raises `TandemError`: control.machine for every wrong field, with its line, and
    what `strict_yaml.read` raises."""
    return strict_yaml.read_as(MachineFile, path, "control.machine")


@dataclasses.dataclass(frozen=True)
class Found:
    """What a machine does with its gains: ``control``, ``most_gain`` [m/(N s)] from which it is refused,
    ``step`` to the wanted force and its ``response``, a ``ramp`` of the gap at ``gap_speed`` [m/s] with the
    largest ``error`` [N] of its second half, ``feed`` [m/s] that keeps the band without noise, ``left`` of
    the former's deflection [-], ``correction`` [m] that the commands make in all."""

    control: Control
    most_gain: float
    step: Trace
    response: Response
    ramp: Trace
    gap_speed: float
    error: float
    feed: float
    left: float
    correction: float


def tried(file: MachineFile, feed: float) -> Found:
    """Gains of a machine and how it runs with them at ``feed`` [m/s]. Raises `TandemError`
    (control.unstable) where they are beyond the border."""
    machine, share = file.value(), file.compensate
    back = share * machine.compliance_gain
    most = machine.most_gain(share)
    gain = machine.gain(share) if file.gain_um_ns is None else file.gain_um_ns * 1e-6
    if back >= 1.0:
        raise TandemError(_runs_away(file, machine))
    if gain >= most:
        raise TandemError(_oscillates(file, machine, gain, most))
    control = Control(gain, share)
    late = machine.dead_time(machine.support) + machine.dead_time(machine.former) / (1.0 - back)
    seconds = float(min(max(30.0 * late, 4.0), RUN_SECONDS))
    first, last = 0.5 * file.force_n, file.force_n
    begin = 5.0 * machine.sensor.cycle
    step = simulate(
        [_quiet(machine)], [control], lambda t: np.where(t < begin, first, last), np.zeros_like, seconds
    )
    speed = file.gap_change * feed
    ramp = simulate([machine], [control], lambda t: np.full_like(t, last), lambda t: speed * t, seconds)
    half = ramp.force[:, ramp.force.shape[1] // 2 :]
    deflection = last / machine.former.stiffness
    return Found(
        control,
        most,
        step,
        step_response(step, first, last),
        ramp,
        speed,
        float(np.abs(half - last).max()),
        float(file.band_n * gain / file.gap_change) if file.gap_change > 0.0 else np.inf,
        float(left_over(share, machine.compliance_gain)) if share > 0.0 else 1.0,
        float(share * deflection),
    )


def _quiet(machine: Machine) -> Machine:
    sensor = dataclasses.replace(machine.sensor, noise=0.0, quantum=0.0)
    return dataclasses.replace(machine, sensor=sensor)


def issues(file: MachineFile, found: Found, feed: float) -> Iterator[Issue]:
    """Warnings: control.band, control.range."""
    if found.error > file.band_n:
        yield Issue(
            "control.band",
            f"{file.name}: at {feed / MM:g} mm/s the gap changes by {found.gap_speed / MM:.3g} mm/s and the "
            f"force is off by up to {found.error:.1f} N, allowed {file.band_n:g} N",
            Severity.WARNING,
            value=found.error,
            limit=file.band_n,
            unit="N",
            hint=f"form at {found.feed / MM:.2g} mm/s at most, or lay the planned change of the gap into the "
            "program, or let the controller's own force loop do it",
        )
    if found.correction > file.correction_mm * MM:
        yield Issue(
            "control.range",
            f"{file.name}: compensation corrects by {found.correction / MM:.2f} mm, allowed "
            f"{file.correction_mm:g} mm",
            Severity.WARNING,
            value=found.correction / MM,
            limit=file.correction_mm,
            unit="mm",
            hint="raise the limit of corrections, or lay the expected part of it into the program",
        )


def _runs_away(file: MachineFile, machine: Machine) -> Issue:
    r = machine.compliance_gain
    return Issue(
        "control.unstable",
        f"{file.name}: compensation of {file.compensate:g} of the former's deflection has a loop gain of "
        f"{file.compensate * r:.2f}, allowed below 1: the contact ({machine.contact * MM:.0f} N/mm) is as "
        f"stiff as the former ({file.former.stiffness_n_mm:g} N/mm)",
        field="compensate",
        value=file.compensate * r,
        limit=1.0,
        hint=f"compensate {0.9 / r:.2f} of it at most",
    )


def _oscillates(file: MachineFile, machine: Machine, gain: float, most: float) -> Issue:
    stiff, late = machine.felt(file.compensate)
    beside = f", compensation of {file.compensate:g} beside it," if file.compensate > 0.0 else ""
    return Issue(
        "control.unstable",
        f"{file.name}: gain {gain * 1e6:.1f} um/(N s), allowed below {most * 1e6:.1f}: with lags of "
        f"{late * 1e3:.0f} ms and a contact of {stiff * MM:.0f} N/mm{beside} the force would swing "
        "up",
        field="gain_um_ns",
        value=gain * 1e6,
        limit=most * 1e6,
        unit="um/(N s)",
        hint=f"take {machine.gain(file.compensate) * 1e6:.1f} um/(N s), or leave it out",
    )
