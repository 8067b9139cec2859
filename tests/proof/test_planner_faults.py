"""No fault of the planner leads to proven programs: faults are put into its code, with its own checks off."""

from __future__ import annotations

import typing
from pathlib import Path
from typing import Final

import pytest
import yaml

from planner.processes.forming.plan.operation import Forming
from planner.runtime.plugins import BUILT_IN, Process
from tests.proof import (
    faults_of_motion,
    faults_of_parts,
    faults_of_processes,
    faults_of_programs,
    faults_of_sag,
)
from tests.proof.planner_faults import CHECKS, SOONER, Fault, clean, instructions, run, thing
from tests.proof.planner_jobs import JOBS

MODULES: Final = (faults_of_parts, faults_of_processes, faults_of_motion, faults_of_programs, faults_of_sag)
FAULTS: Final = {fault.name: fault for module in MODULES for fault in module.FAULTS}
SAMPLE: Final = (
    "mesh_unit",
    "trim_no_kerf",
    "elastic_half_kerf",
    "straight_other_side_of_kerf",
    "held_grip_off",
    "form_ball_too_deep",
    "form_support_farther",
    "form_support_turned",
    "form_border_off",
    "form_heat_other_place",
    "adsif_shifted",
    "tpif_pulse_lost",
    "flank_half_radius",
    "engrave_depth_doubled",
    "gcode_shifted",
    "posed_position_shifted",
    "post_spin_lost",
    "post_meeting_lost",
    "handshake_no_wait",
    "ur_never_watches",
    "krl_a_for_c",
    "sag_wrong_sign",
)
"""Faults that are tried in every run of the tests: each process, mode and language at least once."""


def test_there_are_many_faults_and_each_has_a_name_of_its_own() -> None:
    count = sum(len(module.FAULTS) for module in MODULES)
    assert len(FAULTS) == count >= 80
    assert set(SAMPLE) <= set(FAULTS)


def test_every_fault_and_check_names_something_of_the_planner() -> None:
    for target in [*CHECKS, *SOONER, *(target for fault in FAULTS.values() for target in fault.changes)]:
        assert callable(thing(target)) or isinstance(thing(target), property | float), target


def test_the_sample_has_every_process_mode_and_language(tmp_path: Path) -> None:
    processes, modes, languages = set(), set(), set()
    for name in SAMPLE:
        folder = tmp_path / name
        folder.mkdir()
        data = yaml.safe_load(JOBS[FAULTS[name].job](folder).read_text())
        operation, controller = data["operations"][0], data["cell"]["controller"]
        processes.add(operation["process"])
        modes.add(operation.get("mode"))
        languages.add(controller.get("dialect", controller.get("sync", "rapid")))
        languages |= {"urscript"} if isinstance(data["cell"]["arms"][0]["robot"], dict) else set()
    assert processes == set(BUILT_IN[Process.GROUP])
    assert modes - {None} == set(typing.get_args(Forming.model_fields["mode"].annotation))
    assert languages >= {"krc4", "handshake", "rapid", "urscript"}


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("name", SAMPLE)
def test_a_planner_with_a_fault_gets_nothing_proven(name: str, tmp_path: Path) -> None:
    fault = FAULTS[name]
    verdict = run(fault.job, tmp_path, fault.changes, first_error=True)
    _report(fault, verdict.broken)
    assert verdict.programs, f"no programs came out: {verdict.refused}; another fault would say more"
    assert not verdict.proven


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(FAULTS, key=lambda name: FAULTS[name].job))
def test_every_fault_changes_proven_programs_and_ends_not_proven(name: str, tmp_path: Path) -> None:
    fault = FAULTS[name]
    before, after = clean(fault.job), run(fault.job, tmp_path, fault.changes)
    assert before.proven, (before.refused, before.broken)
    _report(fault, after.broken)
    assert after.programs, f"no programs came out: {after.refused}; another fault would say more"
    assert instructions(after.programs) != instructions(before.programs)
    assert not after.proven


def _report(fault: Fault, broken: tuple[str, ...]) -> None:
    print(f"{fault.name} ({fault.job}): {', '.join(broken) or 'not caught'}")
