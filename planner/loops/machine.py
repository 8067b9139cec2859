"""A machine that forms with force control: its file, its gains, and its simulated behaviour.

The user states stiffness, bandwidth and delay of the arms in the file. The robots of the catalogue do not
state them, so nothing is claimed without this file.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from planner.geometry.units import MM
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError
from planner.loops.force_control import (
    ForceControl,
    ForceSensor,
    ForceTrace,
    FormingMachine,
    ServoAxis,
    StepResponse,
    remaining_deflection,
    simulate_force,
    step_response,
)
from planner.reading import strict_yaml
from planner.reading.strict_yaml import Name, Positive, Strict

INTERFACES: Final = {
    "egm": "Externally Guided Motion: position guidance (EGMRunPose) every 4 ms, with the lag measured on "
    "the arm; set the limits of the correction with EGMSetupUC and EGMActPose",
    "rsi": "RobotSensorInterface: path corrections every 4 or 12 ms (RSI context with POSCORR); set the "
    "limits of POSCORR, by default 5 mm, and ST_ON in relative mode",
}
"""Required settings of each interface by which a controller accepts corrections."""
MAX_RUN_S: Final = 60.0
"""Maximum duration of simulated responses [s]. It is otherwise proportional to the dead time."""


class AxisFile(Strict):
    """An arm with its tool along the line of centres."""

    stiffness_n_mm: Annotated[Positive, Field(description="of arm and tool, measured")]
    bandwidth_hz: Annotated[float, Field(gt=0.1, le=1000, description="of its motion, at -3 dB")]
    poles: Annotated[int, Field(ge=1, le=6, description="of its servo")] = 3
    delay_ms: Annotated[float, Field(ge=0, le=1000, description="until the arm starts to move")] = 0.0

    def value(self) -> ServoAxis:
        """Return the axis in SI units."""
        return ServoAxis(self.stiffness_n_mm / MM, self.bandwidth_hz, self.poles, self.delay_ms / 1000.0)


class SensorFile(Strict):
    """The force sensor and its cycle."""

    cycle_ms: Annotated[float, Field(gt=0.1, le=100)] = 4.0
    filter_hz: Annotated[float, Field(gt=0.1, le=10_000, description="first-order, at -3 dB")] = 40.0
    noise_n: Annotated[float, Field(ge=0, le=1000, description="one standard deviation")] = 0.0
    step_n: Annotated[float, Field(ge=0, le=100, description="of the converter")] = 0.0

    def value(self) -> ForceSensor:
        """Return the sensor in SI units."""
        return ForceSensor(self.cycle_ms / 1000.0, self.filter_hz, self.noise_n, self.step_n)


class MachineFile(Strict):
    """A machine: both arms, the metal between them, the sensor, and the requirements."""

    tandem_machine: Literal[1]
    name: Name = "machine"
    former: AxisFile
    support: AxisFile
    metal_n_mm: Annotated[Positive, Field(description="stiffness of the sheet between both tools")]
    sensor: SensorFile = SensorFile()
    force_n: Annotated[float, Field(gt=0, le=100_000, description="required force of the support")]
    band_n: Annotated[float, Field(gt=0, le=10_000, description="allowed force error")] = 10.0
    gap_change: Annotated[
        float, Field(ge=0, le=1, description="speed at which the gap changes, over the feed")
    ] = 0.05
    compensate: Annotated[float, Field(ge=0, le=1.5, description="fraction of the former's deflection")] = 0.0
    gain_um_ns: Annotated[
        float | None, Field(gt=0, description="integral gain [um/(N s)]; none: the recommended one")
    ] = None
    interface: Literal["egm", "rsi"] | None = None
    correction_mm: Annotated[float, Field(gt=0, le=100, description="largest correction allowed")] = 5.0

    def value(self) -> FormingMachine:
        """Return the machine in SI units."""
        return FormingMachine(
            self.former.value(), self.support.value(), self.metal_n_mm / MM, self.sensor.value()
        )


def read_machine(path: Path) -> MachineFile:
    """Read a machine file.

    Raises:
        TandemError: A field is invalid (``control.machine``, one issue for each, with its line), or the file
            cannot be read, see `strict_yaml.read_file`.
    """
    return strict_yaml.read_file(MachineFile, path, "control.machine")


@dataclasses.dataclass(frozen=True)
class MachineBehaviour:
    """Simulated behaviour of a machine with its gains.

    Attributes:
        control: Settings of the controller.
        max_gain: Gain from which the loop is unstable [m/(N s)].
        step: Run with a step from half of the required force to all of it, without noise.
        response: Overshoot and rise time of this step.
        ramp: Run with a gap that changes at a constant speed.
        gap_speed: This speed [m/s].
        error: Largest force error in the second half of the ramp [N].
        feed: Largest feed at which the force error stays within its band, apart from noise [m/s].
        remaining_deflection: Remaining fraction of the forming arm's deflection [-].
        correction: Correction of the forming arm's deflection that is commanded at the required force [m].
    """

    control: ForceControl
    max_gain: float
    step: ForceTrace
    response: StepResponse
    ramp: ForceTrace
    gap_speed: float
    error: float
    feed: float
    remaining_deflection: float
    correction: float


def simulate_machine(file: MachineFile, feed: float) -> MachineBehaviour:
    """Simulate a machine with its gains: a step of the commanded force, and a ramp of the gap.

    Args:
        file: The machine.
        feed: Feed [m/s], which determines the speed of the ramp.

    Raises:
        TandemError: A gain is at its limit or beyond it (``control.unstable``).
    """
    machine, fraction = file.value(), file.compensate
    loop_gain = fraction * machine.compliance_gain
    max_gain = machine.max_gain(fraction)
    gain = machine.recommended_gain(fraction) if file.gain_um_ns is None else file.gain_um_ns * 1e-6
    if loop_gain >= 1.0:
        raise TandemError(_compensation_issue(file, machine))
    if gain >= max_gain:
        raise TandemError(_gain_issue(file, machine, gain, max_gain))
    control = ForceControl(gain, fraction)
    # Long enough for both loops to settle: 30 dead times, but from 4 s to MAX_RUN_S.
    dead_time = machine.dead_time(machine.support) + machine.dead_time(machine.forming) / (1.0 - loop_gain)
    seconds = float(min(max(30.0 * dead_time, 4.0), MAX_RUN_S))
    start_force, required_force = 0.5 * file.force_n, file.force_n
    step_time = 5.0 * machine.sensor.cycle
    step = simulate_force(
        [_without_noise(machine)],
        [control],
        lambda t: np.where(t < step_time, start_force, required_force),
        np.zeros_like,
        seconds,
    )
    speed = file.gap_change * feed
    ramp = simulate_force(
        [machine], [control], lambda t: np.full_like(t, required_force), lambda t: speed * t, seconds
    )
    # the first half of the ramp is left out, because it contains the transient
    second_half = ramp.force[:, ramp.force.shape[1] // 2 :]
    deflection = required_force / machine.forming.stiffness
    return MachineBehaviour(
        control,
        max_gain,
        step,
        step_response(step, start_force, required_force),
        ramp,
        speed,
        float(np.abs(second_half - required_force).max()),
        float(file.band_n * gain / file.gap_change) if file.gap_change > 0.0 else np.inf,
        float(remaining_deflection(fraction, machine.compliance_gain)) if fraction > 0.0 else 1.0,
        float(fraction * deflection),
    )


def _without_noise(machine: FormingMachine) -> FormingMachine:
    """Return the machine with an ideal force sensor, without noise and quantisation."""
    sensor = dataclasses.replace(machine.sensor, noise=0.0, quantum=0.0)
    return dataclasses.replace(machine, sensor=sensor)


def machine_warnings(file: MachineFile, behaviour: MachineBehaviour, feed: float) -> Iterator[Issue]:
    """Yield warnings if the force error exceeds its band, or the correction its limit.

    Their codes are ``control.band`` and ``control.range``.

    Args:
        file: The machine.
        behaviour: Simulated behaviour of the machine.
        feed: Feed [m/s].
    """
    if behaviour.error > file.band_n:
        yield Issue(
            "control.band",
            format_message(
                "control.band",
                machine=file.name,
                feed_mm_s=feed / MM,
                gap_speed_mm_s=behaviour.gap_speed / MM,
                force_error_n=behaviour.error,
                max_force_error_n=file.band_n,
            ),
            Severity.WARNING,
            value=behaviour.error,
            limit=file.band_n,
            unit="N",
            hint=f"form at {behaviour.feed / MM:.2g} mm/s at most, or include the planned change of the gap "
            "in the program, or use the force loop of the controller",
        )
    if behaviour.correction > file.correction_mm * MM:
        yield Issue(
            "control.range",
            format_message(
                "control.range",
                machine=file.name,
                correction_mm=behaviour.correction / MM,
                max_correction_mm=file.correction_mm,
            ),
            Severity.WARNING,
            value=behaviour.correction / MM,
            limit=file.correction_mm,
            unit="mm",
            hint="raise the limit of corrections, or include the expected part in the program",
        )


def _compensation_issue(file: MachineFile, machine: FormingMachine) -> Issue:
    """Return the issue that the compensation alone is unstable: its loop gain is 1 or more."""
    r = machine.compliance_gain  # loop gain of a full compensation
    return Issue(
        "control.unstable",
        f"{file.name}: compensation of {file.compensate:g} of the former's deflection has a loop gain of "
        f"{file.compensate * r:.2f}, allowed below 1: the contact ({machine.contact * MM:.0f} N/mm) is as "
        f"stiff as the former ({file.former.stiffness_n_mm:g} N/mm)",
        field="compensate",
        value=file.compensate * r,
        limit=1.0,
        hint=f"compensate a fraction of {0.9 / r:.2f} at most",
    )


def _gain_issue(file: MachineFile, machine: FormingMachine, gain: float, max_gain: float) -> Issue:
    """Return the issue that the force loop is unstable, with gains [m/(N s)]."""
    stiffness, dead_time = machine.effective_contact(file.compensate)
    compensation_text = f", and with compensation of {file.compensate:g}," if file.compensate > 0.0 else ""
    return Issue(
        "control.unstable",
        f"{file.name}: gain {gain * 1e6:.1f} um/(N s), allowed below {max_gain * 1e6:.1f}: with lags of "
        f"{dead_time * 1e3:.0f} ms and a contact of {stiffness * MM:.0f} N/mm{compensation_text} the force "
        "would oscillate",
        field="gain_um_ns",
        value=gain * 1e6,
        limit=max_gain * 1e6,
        unit="um/(N s)",
        hint=f"use {machine.recommended_gain(file.compensate) * 1e6:.1f} um/(N s), or leave it out",
    )
