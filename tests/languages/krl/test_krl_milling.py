"""A milling job of a KUKA arm: the operator dialogue, and the extent of the cutter's motion."""

from __future__ import annotations

import copy
import re
from pathlib import Path
from typing import Any

import pytest

from tests.processes.milling.plan.small_mill import WALL
from tests.processes.milling.proof.milling_job import Job

MAIN, MOVES = "robot/wall.src", "robot/wall_1.src"
BLOCK = r"tm_answer=0\r\nWHILE tm_answer<>1\r\ntm_msg=.*{text}.*\r\n(?:.*\r\n){{8}}"
"""A dialog with some text in it, eleven rows."""
READY = BLOCK.format(text="Block and cutter")
QUESTION = rf"(?:tm_answer=0\r\n(?:.*\r\n){{10}})+?{READY}"
"""The question with what is to be read before it."""
DONE = BLOCK.format(text="Spindle st")

FAULTS: dict[str, tuple[str, str, str, str]] = {
    "nobody is asked before the arm moves": ("verify.setup", MAIN, BLOCK.format(text="Is the stock"), ""),
    "nobody is asked before the spindle": ("verify.dialogue", MAIN, QUESTION, ""),
    "a text to be read that no question follows": ("verify.syntax", MAIN, READY, ""),
    "something else is asked": ("verify.dialogue", MAIN, r'"Block and cutter[^"]*"', '"Coffee?"'),
    "asked when it runs already": (
        "verify.dialogue",
        MAIN,
        rf"({QUESTION})(\$OUT\[17\]=TRUE.*\r\n)",
        r"\2\1",
    ),
    "another speed is stated": ("verify.dialogue", MAIN, "12000 1/min", "22000 1/min"),
    "another cutter is stated": ("verify.dialogue", MAIN, "mill of 12 mm", "mill of 10 mm"),
    "nothing is stated": ("verify.dialogue", MAIN, BLOCK.format(text="1/min"), ""),
    "hands come near while it runs down": ("verify.dialogue", MAIN, rf"WAIT SEC 1\r\n({DONE})", r"\1"),
    "nobody says that it stands": ("verify.dialogue", MAIN, DONE, ""),
    "a PLC says that the block is clamped": (
        "verify.syntax",
        MAIN,
        READY,
        ";? Block and cutter?\r\nHALT\r\n",
    ),
    "a run before has left it on": ("verify.signals", MAIN, r"^\$OUT\[17\]=FALSE.*\r\n", ""),
    "another output": ("verify.signals", MAIN, r"\$OUT\[17\]=TRUE", "$OUT[18]=TRUE"),
    "deeper than stated": ("verify.mill_path", MOVES, r"Z (1\d\.\d{4})", "Z 8.0000"),
}


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Job:
    base: dict[str, Any] = copy.deepcopy(WALL)
    base["cell"]["arms"][0]["robot"] = "kr60_ha"
    base["cell"]["controller"] = {"io": {"robot": {"doSpindle": 17}}}
    job = Job(tmp_path_factory.mktemp("wall"), base)
    job.programs = {file.removeprefix("programs/"): text for file, text in job.programs.items()}
    return job


def test_the_clean_job_is_proven(wall: Job) -> None:
    proof = wall.prove(wall.programs, last=None)
    assert proof.ok, proof.issues


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_caught_by_their_rule(wall: Job, fault: str) -> None:
    code, file, old, new = FAULTS[fault]
    text = re.sub(old, new, wall.programs[file], count=1, flags=re.MULTILINE)
    assert text != wall.programs[file]
    assert code in wall.broken({**wall.programs, file: text})


def test_files_are_read_as_a_controller_reads_them(tmp_path: Path, wall: Job) -> None:
    """A lone carriage return would end a comment there; beyond ASCII a letter in code may be anything."""
    for strange in ("; x\r$OUT[17]=TRUE", "HALT\u00e9", "; \u2028$OUT[17]=TRUE"):
        text = wall.programs[MAIN].replace("HALT\r\n", f"HALT\r\n{strange}\r\n", 1)
        assert "verify.syntax" in wall.broken({**wall.programs, MAIN: text})
