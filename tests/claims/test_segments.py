"""Segments: one label and one program name for each, read back alike, for any face names of users."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from planner import pipeline
from planner.catalogue.robots import data_dir
from planner.claims.claim import FeedWindow
from planner.claims.segments import Segment, first_clash, fold
from planner.issues import Severity, TandemError, is_input_error
from planner.languages.krl.reader.parser import marked_comment as marked
from planner.languages.krl.writer.syntax import comment
from planner.languages.rapid.writer.syntax import procedure
from planner.languages.writing import write
from planner.languages.writing.layout import segment_mark
from planner.processes import registry
from planner.programs.text import segment_of_name
from planner.proof import prove
from tests import line_ends, small_problem
from tests.processes.hotwire.plan.straight import test_job as test_straight
from tests.processes.hotwire.proof import straight_job
from tests.processes.milling.plan import small_mill
from tests.proof.planner_jobs import JOBS

PHASES = st.sampled_from(["", "in", "out"])
WORDS = st.sampled_from(
    ["wall", "trim", "x", "in", "out", "on", "In", "ON", "2", "_", "__", "_2", "p1", "k", ""]
)
FILE = st.one_of(
    st.from_regex(r"\A[A-Za-z][A-Za-z0-9_]{0,13}\Z"),
    st.builds(lambda words: ("a" + "_".join(words))[:14], st.lists(WORDS, min_size=1, max_size=5)),
)
"""Names as the fields of problem files have them (:data:`planner.reading.strict_yaml.Name`), and such as look
alike, of lengths that RAPID takes with any kind and phase."""
KINDS = st.one_of(
    st.sampled_from(["cut", "mill", "form", "link"]), st.from_regex(r"\A[A-Za-z][A-Za-z0-9_]{0,4}\Z")
)
"""User-defined kinds (``process: targets``) have underscores too."""
SEGMENTS = st.builds(Segment, KINDS, FILE, PHASES)


def test_labels_of_plain_names_are_what_they_look_like() -> None:
    wall = Segment("cut", "wall")
    assert [str(s) for s in (*wall.all_phases, Segment("link"))] == [
        "cut/wall_in",
        "cut/wall",
        "cut/wall_out",
        "link",
    ]
    assert f"{wall:>9}" == " cut/wall" and wall.word == "cut_wall"
    assert wall.works and not Segment("link").works
    assert len({wall, Segment.of("cut/wall"), Segment.read("cut/wall")}) == 1
    assert not hasattr(wall, "__dict__")
    with pytest.raises(dataclasses.FrozenInstanceError):
        wall.name = "other"  # type: ignore[misc]


def test_a_name_that_ends_like_a_phase_is_no_phase() -> None:
    """A user's ``cut/wall_in`` is the face ``wall_in``; the way in to ``wall`` has the label that plans and
    programs always had."""
    own, way = Segment.of("cut/wall_in"), Segment.read("cut/wall_in")
    assert (own.name, own.phase, way.name, way.phase) == ("wall_in", "", "wall", "in")
    assert [str(s) for s in own.all_phases] == ["cut/wall_in_in", "cut/wall_in_on", "cut/wall_in_out"]
    assert procedure(way) == "cut_wall_in" and procedure(own) == "cut_wall_in_on"
    assert segment_of_name("cut_wall_in") == way and segment_of_name("CUT_wall_in_on__12") == own
    assert str(Segment("cut", "in")) == "cut/in" and str(Segment("cut", "wall_on")) == "cut/wall_on_on"


def test_a_kind_with_underscores_is_no_kind_with_a_name() -> None:
    one, other = Segment("cut_front"), Segment("cut", "front")
    assert procedure(one) == "cut_front__k" and procedure(other) == "cut_front"
    assert segment_of_name("cut_front__k__3") == one and segment_of_name("cut_front__3") == other
    assert segment_of_name(procedure(Segment("my_kind", "k"))) == Segment("my_kind", "k")


@pytest.mark.parametrize("wrong", [("a/b",), ("cut", "", "in"), ("cut", "wall", "on")])
def test_what_is_no_segment(wrong: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match="no segment"):
        Segment(*wrong)


@seed(1)
@settings(max_examples=600, deadline=None)
@given(KINDS, st.one_of(FILE, WORDS, st.text(max_size=12)), PHASES)
def test_every_label_reads_back(kind: str, name: str, phase: Any) -> None:
    segment = Segment(kind, name, phase if name else "")
    assert Segment.read(str(segment)) == segment
    assert segment.folded.folded == segment.folded
    assert Segment.read(segment.key) == segment.folded


@seed(2)
@settings(max_examples=600, deadline=None)
@given(SEGMENTS, st.integers(1, 120))
def test_every_name_in_programs_reads_back(segment: Segment, visit: int) -> None:
    """The proof's reading, by code of its own, gives back what the posts wrote: kind, name and phase but for
    what RAPID cannot tell apart."""
    expected = (fold(segment.kind), fold(segment.name), segment.phase)
    name = procedure(segment)
    assert (again := segment_of_name(name if visit == 1 else f"{name}__{visit}")) == segment.folded
    assert (again.kind, again.name, again.phase) == expected
    (line,) = comment(f"Segment {segment_mark(segment)}: 12 moves, 3 s.")
    (found,) = marked(1, line)
    assert segment_of_name(found.text) == segment.folded


@seed(3)
@settings(max_examples=100, deadline=None)
@given(st.lists(SEGMENTS, min_size=2, max_size=30))
def test_no_two_segments_share_a_name(segments: list[Segment]) -> None:
    """All phases of all names: what programs call alike is alike in all but case and runs of underscores,
    and is refused."""
    every = {way for segment in segments for way in segment.all_phases}
    for one, other in itertools.combinations(every, 2):
        same = procedure(one).lower() == procedure(other).lower()
        assert same == (one.key == other.key) == (first_clash((one, other)) is not None)
        assert same == (one.folded == other.folded) and str(one) != str(other)


def _wall(*names: str, **more: Any) -> dict[str, Any]:
    """A block from whose top a bow cuts strips, the upper ones first, all by one operation."""
    cell = yaml.safe_load(data_dir("problems").joinpath("cells", "irb140_bow.yaml").read_text())
    ruled = []
    for number, name in enumerate(names):
        y, z = 100.0, 90.0 - 22.0 * number
        guide = {"polyline_mm": [[-y, -40, z], [-y, 40, z]]}, {"polyline_mm": [[y, -40, z], [y, 40, z]]}
        ruled.append({"name": name, "start": guide[0], "end": guide[1], "flip": True})
    operation = {
        "name": "faces",
        "process": "straight_wire",
        "arms": ["robot"],
        "power_w": 46,
        "feed_mm_s": 6,
        "feed_min_mm_s": 4,
        "shape_tol_mm": 0.4,
        "cuts": [{"surface": name} for name in names],
    }
    return {
        "tandem": 1,
        "name": "wall",
        "accept": ["stock.hangs"],
        "cell": cell,
        "stock": {"size_mm": [200, 80, 100], "foam": "eps_a120", "place": "auto"},
        "part": {"ruled": ruled, "in_stock": {}},
        "operations": [operation | more],
    }


def _written(folder: Path, problem: dict[str, Any]) -> Path:
    path = folder / "problem.yaml"
    path.write_text(yaml.safe_dump(problem, sort_keys=False))
    return path


def test_faces_whose_names_look_like_those_of_the_process_plan_and_prove(tmp_path: Path) -> None:
    """``wall_in`` beside ``wall``, whose way in is called so, and ``trim_x``, as the cuts of sides are."""
    outcome = pipeline.plan(pipeline.load(_written(tmp_path, _wall("wall", "wall_in", "trim_x"))))
    assert outcome.verified, outcome.issues
    assert [str(face.segment) for face in outcome.proof.surfaces] == [
        "cut/wall",
        "cut/wall_in_on",
        "cut/trim_x",
    ]
    text = "".join(outcome.programs.values())
    for name in ("cut_wall_in", "cut_wall_in_in", "cut_wall_in_on", "cut_wall_in_out", "cut_trim_x"):
        assert text.count(f"PROC {name}()") == 1


def test_labels_of_users_come_back_as_they_meant_them(tmp_path: Path) -> None:
    """In ``process: targets``: each row's label is a kind and a name, never a phase of the process's own."""
    labels = ["cut/wall", "cut/wall", "cut/wall_in", "Weld/Seam", "weld_seam", "cut/wall_in"]
    rows = [f"{row},{label}" for row, label in zip(small_problem.ROWS, labels, strict=True)]
    table = "\n".join([f"{small_problem.COLUMNS},segment", *rows]) + "\n"
    outcome = pipeline.plan(pipeline.load(small_problem.write(tmp_path, table=table)))
    assert outcome.verified, outcome.issues
    read = [
        segment_of_name(name) for name in re.findall(r"PROC (\w+)\(\)", "".join(outcome.programs.values()))
    ]
    assert [Segment.of(label).folded for label in labels[1:]] == [
        s for s in read if s.kind in ("cut", "weld", "weld_seam")
    ]


def _milled(flanks: list[str], **first: Any) -> dict[str, Any]:
    """Return a block with adjacent walls, each milled by its flank."""
    data = copy.deepcopy(small_mill.WALL)
    (wall,) = data["part"]["ruled"]
    data["part"]["ruled"] = [wall | {"name": name} for name in flanks]
    data["operations"][0]["cuts"] = [{"flank": name} for name in flanks]
    data["operations"][0]["cuts"][0] |= first
    return data


CLASHES: dict[str, tuple[dict[str, Any], str, str]] = {
    "faces that differ in case": (_wall("wall", "Wall", cuts="all"), "problem.field", "part"),
    "faces that differ in underscores": (_wall("a_b", "a__b", cuts="all"), "problem.field", "part"),
    "a face called as a side that is trimmed": (
        _wall("trim_left", cuts=[{"surface": "trim_left"}, {"trim": ["left"]}]),
        "problem.field",
        "operations.0",
    ),
    "a face that is cut twice": (
        _wall("wall", cuts=[{"surface": "wall"}, {"surface": "wall"}]),
        "problem.field",
        "operations.0",
    ),
    "a wall called as a roughing pass": (
        _milled(["wall", "wall_r1"], stepdown_mm=10),
        "problem.duplicate_name",
        "operations.cuts",
    ),
    "a name too long for the way out": (_wall("a" * 24), "post.name", "operations.0"),
}


@pytest.mark.parametrize("name", CLASHES)
def test_names_that_collide_are_refused_before_anything_is_planned(tmp_path: Path, name: str) -> None:
    data, code, field = CLASHES[name]
    path = _written(tmp_path, data)
    try:
        found = [i for i in pipeline.check(pipeline.load(path)) if i.severity is Severity.ERROR]
    except TandemError as error:
        found = list(error.issues)
    assert {issue.code for issue in found} == {code} and is_input_error(found)  # exit code 2
    for issue in found:
        assert issue.field is not None and issue.field.startswith(field)
        assert re.search("rename|shorten|at most", f"{issue.message} {issue.hint}")


def test_surfaces_built_in_python_are_held_to_the_same() -> None:
    with pytest.raises(TandemError) as caught:
        test_straight.make(*(test_straight.square(name, 0.0, 0.05, 0.02) for name in "Aa"))
    assert [issue.code for issue in caught.value.issues] == ["problem.duplicate_name"]


@pytest.mark.parametrize("label", ["w/stock", "operation/1", "t/bow", "main", "cut/one", "cut/" + "x" * 30])
def test_labels_that_are_names_of_other_things(tmp_path: Path, label: str) -> None:
    rows = [f"{row},{label if number else 'cut/One'}" for number, row in enumerate(small_problem.ROWS)]
    table = "\n".join([f"{small_problem.COLUMNS},segment", *rows]) + "\n"
    found = pipeline.check(pipeline.load(small_problem.write(tmp_path, table=table)))
    assert [(issue.code, issue.field) for issue in found] == [("post.name", "operations.0")]


@pytest.mark.parametrize("process", ["straight", "milling"])
def test_two_operations_of_one_setup_with_one_segment_are_refused(tmp_path: Path, process: str) -> None:
    """They ended not proven: each was held against what the other claims."""
    data = _wall("wall") if process == "straight" else _milled(["wall"])
    data["operations"].append(data["operations"][0] | {"name": "again", "feed_mm_s": 5})
    found = [i for i in pipeline.check(pipeline.load(_written(tmp_path, data))) if i.code == "post.name"]
    assert [issue.field for issue in found] == ["operations.1"]
    assert "'again'" in found[0].message and "wall" in found[0].message and "setup" in str(found[0].hint)


def test_two_operations_with_one_cut_of_g_code_are_refused(tmp_path: Path) -> None:
    path = JOBS["gcode"](tmp_path)
    data = yaml.safe_load(path.read_text())
    data["operations"].append(data["operations"][0] | {"name": "again"})
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    found = [i for i in pipeline.check(pipeline.load(path)) if i.severity is Severity.ERROR]
    assert [(issue.code, issue.field) for issue in found] == [("post.name", "operations.1")]


def test_two_setups_may_work_on_one_segment_each_by_its_own_claims(tmp_path: Path) -> None:
    """Roughly and then finely, with another cutter: each pass is held against its own feed."""
    data = _milled(["wall"])
    tool = small_mill.MILL | {"diameter_mm": 10}
    again = {"name": "again", "feed_mm_s": 60, "setup": {"tools": {"robot": tool}}}
    data["operations"].append(data["operations"][0] | again)
    problem = pipeline.load(_written(tmp_path, data))
    outcome = pipeline.plan(problem)
    assert outcome.verified, outcome.issues
    claims = registry.claims(problem)
    for name, own in claims.items():
        slow = [dataclasses.replace(c, upper=0.02) if isinstance(c, FeedWindow) else c for c in own]
        proof = prove.prove(problem, claims | {name: tuple(slow)}, outcome.programs)
        assert not proof.rule("verify.mill_feed").passed, name


@pytest.mark.parametrize("model", ["irb140", "kr10_r1100"])
def test_programs_of_both_languages_tell_such_faces_apart(
    model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Written by the posts and proven: ``wall`` by the first operation, ``wall_in`` by the second."""
    monkeypatch.setattr(straight_job, "NAMES", ("wall", "wall_in"))
    texts = line_ends.bare(write.program_files(straight_job.plan(model=model), straight_job.problem(model)))
    proof = prove.prove(straight_job.problem(model), straight_job.claims(), texts)
    assert proof.ok, proof.issues
    played = list(dict.fromkeys(proof.series["targets/label"].tolist()))
    assert [name for name in played if name.startswith("cut")] == [
        *("cut/wall_in", "cut/wall", "cut/wall_out"),
        *("cut/wall_in_in", "cut/wall_in_on", "cut/wall_in_out"),
    ]
    monkeypatch.setattr(straight_job, "NAMES", ("wall", "wall_i"))
    assert not prove.prove(straight_job.problem(model), straight_job.claims(), texts).ok
