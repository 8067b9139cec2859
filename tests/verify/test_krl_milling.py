"""A milling job of a KUKA arm: what its operator is told and asked, and how far its cutter goes."""

from __future__ import annotations

import copy
import re
from pathlib import Path
from typing import Any

import pytest

from tests.milling.small_mill import WALL
from tests.verify.test_rules_milling import Job

MAIN, MOVES = "robot/wall.src", "robot/wall_1.src"
READY = r"^;\? Block and cutter.*\r\nHALT\r\n"

FAULTS: dict[str, tuple[str, str, str, str]] = {
    "nobody is asked before the arm moves": ("verify.setup", MAIN, r"^;\? Is the stock.*\r\nHALT\r\n", ""),
    "nobody is asked before the spindle": ("verify.dialogue", MAIN, READY, ""),
    "something else is asked": ("verify.dialogue", MAIN, r"^;\? Block and.*\r", ";? Coffee?\r"),
    "asked when it runs already": (
        "verify.dialogue",
        MAIN,
        rf"({READY})(\$OUT\[17\]=TRUE.*\r\n)".replace("^", ""),
        r"\2\1",
    ),
    "another speed is told": ("verify.dialogue", MAIN, "12000 1/min", "22000 1/min"),
    "another cutter is told": ("verify.dialogue", MAIN, "mill of 12 mm", "mill of 10 mm"),
    "nothing is told": ("verify.dialogue", MAIN, r"^;\* Block.*\r\n", ""),
    "hands come near while it runs down": (
        "verify.dialogue",
        MAIN,
        r"WAIT SEC 1\r\n(;\? Spindle)",
        r"\1",
    ),
    "nobody says that it stands": ("verify.dialogue", MAIN, r"^;\? Spindle.*\r\nHALT\r\n", ""),
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


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_caught_by_their_rule(wall: Job, fault: str) -> None:
    code, file, old, new = FAULTS[fault]
    text = re.sub(old, new, wall.programs[file], count=1, flags=re.MULTILINE)
    assert text != wall.programs[file]
    assert code in wall.broken({**wall.programs, file: text})


def test_files_are_read_as_a_controller_reads_them(tmp_path: Path, wall: Job) -> None:
    """A lone carriage return would end a comment there, and letters beyond ASCII may be anything."""
    for strange in ("; x\r$OUT[17]=TRUE", "; caf\u00e9", "; \u2028$OUT[17]=TRUE"):
        text = wall.programs[MAIN].replace("HALT\r\n", f"HALT\r\n{strange}\r\n", 1)
        assert "verify.syntax" in wall.broken({**wall.programs, MAIN: text})
