"""Jobs with operator dialogues: the bent wire of ``small_job`` and the bow of ``straight_job``.

The bow leaves spacers in its first slot. The figures are computed by hand.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from planner.claims.claim import ContactOnlyIn, OneOf
from planner.claims.dialogue import (
    DialogueStop,
    OperatorDialogue,
    message_step,
    power_off_steps,
    power_on_steps,
    question_step,
)
from planner.claims.segments import Segment
from planner.languages.writing import write
from planner.processes.hotwire import sentences as hotwire_sentences
from planner.processes.hotwire.claims import WireJoins
from planner.targets import TargetAction
from tests.processes.hotwire.proof import straight_job
from tests.proof import small_job
from tests.proof.small_job import AWAY, LENGTH, SIGNAL

COLD_MM = 493.2
SLOT_MM = 1.2
POWER_W = 78.0


def clamps():
    """Distance of the clamps [mm] and angles of the wire [deg] at the mount: those of a circular arc."""
    angle = float(small_job.half_angle(AWAY))
    return LENGTH / angle * np.sin(angle) * 1e3, np.rad2deg(angle), -np.rad2deg(angle)


def bent(count=12):
    """The plan of the bent wire, with its whole operator dialogue."""
    whole = small_job.plan(count)
    (operation,) = whole.operations
    last = operation.targets.count - 1
    apart, start, end = clamps()
    actions = (
        TargetAction(0, "message", hotwire_sentences.MOUNT.format(cold_mm=COLD_MM)),
        TargetAction(
            0, "message", hotwire_sentences.CLAMPS.format(apart_mm=apart, start_deg=start, end_deg=end)
        ),
        TargetAction(0, "confirm", hotwire_sentences.CLAMPED.format()),
        TargetAction(0, "on", signal=SIGNAL),
        TargetAction(0, "wait", seconds=10.0),
        TargetAction(0, "confirm", hotwire_sentences.LOCKED.format(hot_mm=1e3 * LENGTH)),
        TargetAction(last, "off", signal=SIGNAL),
        TargetAction(last, "wait", seconds=30.0),
        TargetAction(last, "confirm", hotwire_sentences.TAKEN_OFF.format()),
    )
    targets = dataclasses.replace(operation.targets, actions=actions)
    return dataclasses.replace(whole, operations=(dataclasses.replace(operation, targets=targets),))


def bent_claims():
    """The claims of its process."""
    spoken = OperatorDialogue(
        ("left", "right"),
        (
            message_step(hotwire_sentences.MOUNT, cold_mm=COLD_MM),
            message_step(hotwire_sentences.CLAMPS, apart_mm=None, start_deg=None, end_deg=None),
            question_step(hotwire_sentences.CLAMPED),
            *power_on_steps(SIGNAL, 10.0),
            question_step(hotwire_sentences.LOCKED, hot_mm=1e3 * LENGTH),
        ),
        (*power_off_steps(SIGNAL, 30.0), question_step(hotwire_sentences.TAKEN_OFF)),
        joined=True,
    )
    return {"panel": _with_dialogue(small_job.claims()["panel"], spoken)}


LONGER_MM = 20.0
"""Additional length of the other wire of :func:`choice_claims`."""


def choice():
    """The plan of the bent wire where the problem leaves open which one it is."""
    whole = bent()
    (operation,) = whole.operations
    named = TargetAction(
        0, "message", hotwire_sentences.WIRE.format(material="spring_steel", size="1.5 mm round")
    )
    targets = dataclasses.replace(operation.targets, actions=(named, *operation.targets.actions))
    return dataclasses.replace(whole, operations=(dataclasses.replace(operation, targets=targets),))


def choice_claims():
    """The claims of its process: one of two wires of one section, or a thinner one."""
    return {"panel": (OneOf((_wire(LONGER_MM), _wire(0.0), _wire(0.0, "1 mm round"))),)}


def _wire(longer, size="1.5 mm round"):
    (group,) = bent_claims().values()
    (spoken,) = (claim for claim in group if isinstance(claim, OperatorDialogue))
    named = message_step(hotwire_sentences.WIRE, material="spring_steel", size=size)
    first = [named, *spoken.first]
    first[1] = message_step(hotwire_sentences.MOUNT, cold_mm=COLD_MM + longer)
    first[-1] = question_step(hotwire_sentences.LOCKED, hot_mm=1e3 * LENGTH + longer)
    group = _with_dialogue(group, dataclasses.replace(spoken, first=tuple(first)))
    return tuple(
        dataclasses.replace(claim, length=LENGTH + 1e-3 * longer) if isinstance(claim, WireJoins) else claim
        for claim in group
    )


@functools.cache
def choice_programs():
    """The texts of :func:`choice` as the planner writes them."""
    return write.program_files(choice(), small_job.problem())


def bow(model="irb140", count=12):
    """The plan of the bow, with its dialogue, power in both operations, and spacers after the first cut."""
    whole = straight_job.plan(count, model=model)
    operations = []
    for number, operation in enumerate(whole.operations):
        targets = operation.targets
        ends = [i for i, segment in enumerate(targets.segment) if segment.phase == "out"]
        last = targets.count - 1
        wire = {"diameter_mm": 0.4, "material": " nichrome", "power_w": POWER_W}
        actions = [
            TargetAction(0, "message", hotwire_sentences.BOW_POWER.format(**wire)),
            TargetAction(0, "confirm", hotwire_sentences.TAUT.format()),
            TargetAction(0, "on", signal=SIGNAL),
            TargetAction(0, "wait", seconds=5.0),
        ]
        stop = targets.stop.copy()
        if number == 0:
            stop[ends[-1]] = True
            actions += [
                TargetAction(ends[-1], "off", signal=SIGNAL),
                TargetAction(ends[-1], "wait", seconds=10.0),
                TargetAction(ends[-1], "message", hotwire_sentences.SPACERS.format(kerf_mm=SLOT_MM)),
                TargetAction(ends[-1], "confirm", hotwire_sentences.SPACED.format()),
                TargetAction(ends[-1], "on", signal=SIGNAL),
                TargetAction(ends[-1], "wait", seconds=5.0),
            ]
        actions += [
            TargetAction(last, "off", signal=SIGNAL),
            TargetAction(last, "wait", seconds=10.0),
            TargetAction(last, "confirm", hotwire_sentences.COLD.format()),
        ]
        targets = dataclasses.replace(targets, actions=tuple(actions), stop=stop)
        operations.append(dataclasses.replace(operation, targets=targets))
    return dataclasses.replace(whole, operations=tuple(operations))


def bow_claims():
    """The claims of its process."""
    on, off = power_on_steps(SIGNAL, 5.0), power_off_steps(SIGNAL, 10.0)
    wire = {"diameter_mm": 0.4, "material": " nichrome", "power_w": POWER_W}
    out = {}
    for number, (name, group) in enumerate(straight_job.claims().items()):
        segment = Segment("cut", straight_job.NAMES[number]).at("out")
        steps = (
            *off,
            message_step(hotwire_sentences.SPACERS, kerf_mm=None),
            question_step(hotwire_sentences.SPACED),
            *on,
        )
        spoken = OperatorDialogue(
            ("left",),
            (message_step(hotwire_sentences.BOW_POWER, **wire), question_step(hotwire_sentences.TAUT), *on),
            (*off, question_step(hotwire_sentences.COLD)),
            (DialogueStop(segment, "behind", steps),) if number == 0 else (),
        )
        out[name] = _with_dialogue(group, spoken)
    return out


def _with_dialogue(group, dialogue):
    """Claims with another dialogue."""
    assert any(isinstance(claim, ContactOnlyIn) for claim in group)
    return (*(claim for claim in group if not isinstance(claim, OperatorDialogue)), dialogue)


@functools.cache
def bent_programs():
    """The texts of the bent wire as the planner writes them."""
    return write.program_files(bent(), small_job.problem())


@functools.cache
def bow_problem(model="irb140", dialect="krc4"):
    """The problem of the bow, for a KUKA controller of a dialect."""
    made = straight_job.problem(model)
    controller = dataclasses.replace(made.cell.controller, dialect=dialect)
    return dataclasses.replace(made, cell=dataclasses.replace(made.cell, controller=controller))


def bow_programs(model="irb140", dialect="krc4"):
    """The texts of the bow as the planner writes them."""
    return write.program_files(bow(model), bow_problem(model, dialect))
