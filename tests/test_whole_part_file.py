"""A part from a mesh file, from its problem to the proof of the written files.

The file is read twice, by the planner and by the proof. A copy that is changed later is reported.
"""

from __future__ import annotations

import shutil

import pytest

import planner
from planner import pipeline
from planner.geometry.mesh import TriangleMesh
from planner.issues import TandemError
from planner.reading import part_surfaces
from tests.proof.planner_jobs import JOBS


@pytest.fixture(scope="module")
def panel(tmp_path_factory):
    """A ruled face of a block, from a mesh file."""
    return planner.plan(planner.load(JOBS["ruled_mesh"](tmp_path_factory.mktemp("panel"))))


@pytest.fixture(scope="module")
def saved_problem(panel, tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved") / "out"
    panel.save(folder)
    return folder


@pytest.fixture
def carried_copy(saved_problem, tmp_path):
    """The result folder, and the copy of the mesh in it."""
    shutil.copytree(saved_problem, tmp_path / "out")
    (mesh,) = (tmp_path / "out" / "problem" / "files").glob("*.obj")
    return tmp_path / "out", mesh


def proven(folder):
    return pipeline.verify(pipeline.load_result(folder), pipeline.read_programs(folder))


def test_a_file_that_both_read_alike_is_proven(panel, carried_copy) -> None:
    rule = panel.proof.rule("verify.part_file")
    assert panel.verified
    assert rule.where == "600 points of face.obj"
    assert rule.worst >= 95.0
    assert proven(carried_copy[0]).ok


@pytest.mark.long
@pytest.mark.parametrize(
    "wrong", [lambda v: v * [1.0, 1.0, 0.9], lambda v: v * 0.93], ids=["flatter", "smaller"]
)
def test_a_file_that_the_planner_reads_otherwise_is_not_proven(monkeypatch, wrong) -> None:
    """All else follows the wrong reading, so that no other rule sees it."""
    read = part_surfaces.read_mesh

    def otherwise(path, unit):
        mesh = read(path, unit)
        return TriangleMesh(wrong(mesh.vertices), mesh.faces)

    monkeypatch.setattr(part_surfaces, "read_mesh", otherwise)
    outcome = planner.plan(planner.load("hypar_panel"))
    assert not outcome.verified
    assert not outcome.programs
    assert [rule.code for rule in outcome.proof.rules if not rule.passed] == ["verify.part_file"]
    assert "hypar.obj as read" in outcome.proof.issues[0].message


def test_a_copy_that_is_changed_later_is_told_by_its_name(carried_copy) -> None:
    folder, mesh = carried_copy
    lines = mesh.read_text().splitlines()
    rows = [i for i, line in enumerate(lines) if line.startswith("v ")]
    for i in rows:
        x, y, z = (float(word) for word in lines[i].split()[1:4])
        lines[i] = f"v {x} {y} {0.9995 * z}"
    mesh.write_text("\n".join(lines))
    proof = proven(folder)
    assert not proof.ok
    issues = [
        issue
        for issue in proof.issues
        if issue.code == "verify.digest" and issue.file == f"files/{mesh.name}"
    ]
    assert "has changed since" in issues[0].message


def test_a_copy_that_is_gone_or_broken_is_told_by_its_name(carried_copy) -> None:
    folder, mesh = carried_copy
    data = mesh.read_bytes()
    mesh.write_bytes(data[: len(data) // 3])
    with pytest.raises(TandemError) as caught:
        pipeline.load_result(folder)
    assert mesh.name in str(caught.value)
    mesh.unlink()
    with pytest.raises(TandemError) as caught:
        pipeline.load_result(folder)
    assert [issue.code for issue in caught.value.issues] == ["problem.missing_file"]
    assert mesh.name in str(caught.value)
