"""A simulated UR controller runs the text of a torch program.

The torch burns only in slots, whatever stops the program. After a stop in a slot the torch stays off and the
program does not continue.
"""

from __future__ import annotations

import random

import numpy as np
import pytest

from tests.processes.trim.plan.small_trim import OUTLINES, Job, of_ur
from tests.processes.trim.plan.ur_machine import TICK, Machine

FILE = "robot/trimmed.script"
LOST = "doArc is off, no diArcOk, or the torch stood: the program ends. Move it out by hand."
NO_ARC = "No diArcOk in 5 s: the program ends. Begin it anew."
FEED = 8e-3
"""Feed of the slots [m/s]."""
SEEN = 0.05
"""Time [s] within which the thread sees that the output has fallen; its first look comes 0.1 s later."""


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("trim")
    return Job(folder, outlines=[OUTLINES[0]], **of_ur(folder)).programs[FILE]


@pytest.fixture(scope="module")
def clean(text: str) -> Machine:
    machine = Machine(text)
    machine.run()
    return machine


def burning(machine: Machine) -> tuple[int, int]:
    """The first and the last tick with the torch on."""
    return machine.burned[0][0], machine.burned[-1][0]


def test_it_burns_in_its_slot_and_nowhere_else(clean: Machine) -> None:
    first, last = burning(clean)
    assert last - first + 1 == len(clean.burned)
    places = np.array([place for _, place in clean.burned])
    radius = np.linalg.norm(places[:, :2], axis=1)
    assert radius.max() == pytest.approx(7.4e-3, abs=0.2e-3)  # half a kerf inside of the hole
    assert LOST not in clean.messages and clean.messages[-1].startswith("Torch off")


def test_behind_a_pause_nothing_is_lit_and_nothing_goes_on(text: str, clean: Machine) -> None:
    first, last = burning(clean)
    begins = first + round((0.2 + 0.5) / TICK)  # the arc burns, and has pierced
    for at in random.Random(1).sample(range(begins + 2, last), 25):
        machine = Machine(text)
        machine.run(at)
        way, count = machine.travelled, len(machine.burned)
        machine.pause()
        machine.run(100)
        machine.play()
        machine.run()
        assert machine.messages[-1] == LOST and len(machine.burned) == count
        assert machine.travelled - way < FEED * (SEEN + 0.1)


def test_a_pause_over_the_pierce_point_ends_it_too(text: str, clean: Machine) -> None:
    first, _ = burning(clean)
    for after in (0, 5, 19, 25, 60):
        machine = Machine(text)
        machine.run(first + after)
        way, count = machine.travelled, len(machine.burned)
        machine.pause()
        machine.run(100)
        machine.play()
        machine.run()
        assert machine.messages[-1] in (LOST, NO_ARC) and len(machine.burned) == count
        assert machine.travelled - way < FEED * (SEEN + 0.1)


def test_a_pause_elsewhere_is_an_ordinary_one(text: str, clean: Machine) -> None:
    first, last = burning(clean)
    for at in (first - 30, first - 2, last + 2, last + 30):
        machine = Machine(text)
        machine.run(at)
        machine.pause()
        machine.run(100)
        machine.play()
        machine.run()
        assert machine.messages == clean.messages and len(machine.burned) == len(clean.burned)


def test_where_outputs_come_back_the_input_ends_it(text: str, clean: Machine) -> None:
    """A controller that is not as it should be lights the torch again; its arc takes half a second."""
    first, last = burning(clean)
    machine = Machine(text, gives_back=True)
    machine.run((first + last) // 2)
    machine.pause()
    machine.run(100)
    machine.lights = 50
    machine.play()
    count = len(machine.burned)
    machine.run()
    assert machine.messages[-1] == LOST
    assert len(machine.burned) - count < 0.3 / TICK


def test_an_arc_that_goes_out_ends_it(text: str, clean: Machine) -> None:
    first, last = burning(clean)
    machine = Machine(text)
    machine.run((first + last) // 2)
    machine.arc_lost = True
    machine.run(15)
    machine.arc_lost = False  # a flicker
    machine.run(50)
    assert machine.runs
    machine.arc_lost = True
    count = len(machine.burned)
    machine.run()
    assert machine.messages[-1] == LOST and len(machine.burned) - count < 0.3 / TICK


def test_an_arc_that_never_burns_ends_it(text: str, clean: Machine) -> None:
    machine = Machine(text)
    machine.lights = None
    machine.run()
    assert machine.messages[-1] == NO_ARC
    assert len(machine.burned) * TICK == pytest.approx(5.0, abs=0.2)


@pytest.mark.parametrize("slider", [0.0, 0.02])
def test_a_torch_that_stands_ends_it(text: str, clean: Machine, slider: float) -> None:
    """As by the slider at its end, which is 2 % at the panel, while the program goes on."""
    first, last = burning(clean)
    machine = Machine(text)
    machine.run((first + last) // 2)
    machine.slider = slider
    count = len(machine.burned)
    machine.run()
    assert machine.messages[-1] == LOST and (len(machine.burned) - count) * TICK < 4.0


def test_one_that_is_on_before_the_program_ends_it(text: str) -> None:
    machine = Machine(text)
    machine.high.add(3)
    machine.run()
    assert machine.messages == [
        "doArc is on before the program: set it to low when not running in Installation, I/O."
    ]
    assert machine.travelled == 0.0
