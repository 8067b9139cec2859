"""Line ends, endings and encodings of RAPID files, as RobotWare 6 and 7 load them; and their proof."""

from __future__ import annotations

import dataclasses
import functools
import re

import pytest

from planner import pipeline
from planner.issues import TandemError
from planner.languages.writing import write
from planner.proof.prove import Prover
from tests.proof import provers, small_job

COUNT = 12


@functools.cache
def job(robotware):
    plain = small_job.problem()
    controller = dataclasses.replace(plain.cell.controller, robotware=robotware)
    return dataclasses.replace(plain, cell=dataclasses.replace(plain.cell, controller=controller))


@functools.cache
def written(robotware=6):
    return write.program_files(small_job.plan(COUNT), job(robotware))


@functools.cache
def prover(robotware):
    return Prover(job(robotware), small_job.claims())


def broken(files, robotware=6, last="verify.files"):
    proof = prover(robotware).prove(files, last=last)
    return provers.broken(proof)


@pytest.mark.parametrize("robotware", [6, 7])
def test_all_lines_end_as_a_controller_loads_them_and_programs_prove(robotware):
    files = written(robotware)
    rapid = {name: text for name, text in files.items() if name.startswith("T_ROB")}
    assert all(re.search(r"(?<!\r)\n|\r(?!\n)", text) is None for text in rapid.values())
    assert all(text.endswith("\r\n") and text.isascii() for text in rapid.values())
    assert prover(robotware).prove(files).ok


def test_robotware_7_gets_modx_and_lists_that_name_them():
    old, new = written(6), written(7)
    assert {name.rpartition(".")[2] for name in new if name.startswith("T_")} == {"modx", "pgf"}
    assert "<Module>TandemData_1.modx</Module>" in new["T_ROB1/Tandem_1.pgf"]
    assert new["T_ROB1/TandemCut1_1.modx"] == old["T_ROB1/TandemCut1_1.mod"]


def test_modules_of_the_other_robotware_are_refused():
    assert broken(written(7), 6) == broken(written(6), 7) == {"verify.files"}
    renamed = {name.replace(".mod", ".modx"): text for name, text in written(6).items()}
    assert "verify.files" in broken(renamed, 7)  # the lists name other files


@pytest.mark.parametrize(
    ("old", "new"), [("\r\n", "\n"), ("\r\n", "\r"), ("</Program>\r\n", "</Program>"), (".mod<", "<")]
)
def test_a_program_list_that_does_not_load_is_refused(old, new):
    name = "T_ROB2/Tandem_2.pgf"
    assert "verify.files" in broken({**written(), name: written()[name].replace(old, new)})


def test_modules_with_bare_line_feeds_are_read_as_a_controller_reads_them():
    bare = {n: t.replace("\r\n", "\n") if n.endswith(".mod") else t for n, t in written().items()}
    assert prover(6).prove(bare).ok


def test_files_are_read_back_byte_by_byte(tmp_path):
    folder = tmp_path / "programs" / "T_ROB1"
    folder.mkdir(parents=True)
    (folder / "a.mod").write_bytes(b"! \xe4\r\n")
    (folder / "b.modx").write_bytes("! ä\n".encode())
    assert pipeline.read_programs(tmp_path) == {"T_ROB1/a.mod": "! ä\r\n", "T_ROB1/b.modx": "! ä\n"}
    (folder / "b.modx").write_bytes(b"! \xe4\r\n")
    with pytest.raises(TandemError) as refused:
        pipeline.read_programs(tmp_path)
    assert refused.value.issues[0].code == "verify.files"


def test_a_byte_order_mark_is_refused():
    name = "T_ROB1/TandemMain_1.modx"
    assert "verify.syntax" in broken({**written(7), name: "\ufeff" + written(7)[name]}, 7)
