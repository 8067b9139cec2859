"""Element files, good and bad: what is refused, with which remedy, and that the remedy is enough."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner import pipeline
from planner.cli.batch import Batch, run_batch
from planner.cli.element import ElementRequest, run_element
from planner.element import elastic, element_file, output
from planner.element.jobs import panel_files
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, TandemError, has_errors, is_input_error
from planner.processes import registry
from tests.element.walls import ROOT, element, wall


def divide(path: Path) -> dict[str, str]:
    """The files of an element by their names."""
    read = element_file.read_element(path)
    panels = elastic.divide_elastic(elastic.prepare_division(read.surface, read.cells, read.rules))
    return output.elastic_folder(read, panels)[0]


def refusal(path: Path) -> Issue:
    """The one issue that an element is refused with."""
    with pytest.raises(TandemError) as caught:
        divide(path)
    assert len(caught.value.issues) == 1
    return caught.value.issues[0]


def advised_value(issue: Issue, pattern: str) -> float:
    """A number that an issue's hint gives."""
    match = re.search(pattern, str(issue.hint))
    assert match is not None, issue.hint
    return float(match.group(1))


def require_valid_targets(path: Path) -> None:
    """All that a panel's wire is to do, with every finding of the process itself."""
    for job in registry.jobs(pipeline.load(path)):
        assert not has_errors(job.targets().issues)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("element")
    run_element(ElementRequest(element(folder), folder / "out"))
    return folder / "out"


def test_the_folder_has_a_problem_for_each_panel_a_table_a_drawing_and_data(out: Path) -> None:
    data = json.loads((out / "element.json").read_text())
    names = [panel["id"] for panel in data["panels"]]
    rows = list(csv.DictReader((out / "panels.csv").open()))
    assert [row["id"] for row in rows] == names == sorted(names)
    assert sorted(path.stem for path in (out / "panels").glob("*.yaml")) == names
    drawing = (out / "panels.svg").read_text()
    assert all(f">{name}<" in drawing for name in names)
    assert "http" not in drawing.replace("http://www.w3.org/2000/svg", "")
    for name in names:
        problem = pipeline.load(out / "panels" / f"{name}.yaml")
        assert problem.name == f"small_{name}"
        assert problem.part is not None and problem.part.back is not None
        # the sides can be cut as well: front and back have one rim each, with equally many corners
        assert [ruled.name for ruled in problem.part.ruled] == ["edges"]


def held_panels(out: Path) -> list[str]:
    """Two panels whose wire is held safely."""
    rows = csv.DictReader((out / "panels.csv").open())
    return [row["id"] for row in rows if row["wire_held"] == "yes"][:2]


def test_two_panels_pass_the_check_as_they_are_written(out: Path) -> None:
    """Their faces can be cut by the chosen wire; the long test checks reach."""
    assert len(held_panels(out)) == 2
    for name in held_panels(out):
        require_valid_targets(out / "panels" / f"{name}.yaml")


@pytest.mark.long
def test_two_panels_pass_the_whole_check(out: Path) -> None:
    for name in held_panels(out):
        assert not has_errors(pipeline.check(pipeline.load(out / "panels" / f"{name}.yaml")))


def test_ids_and_problems_do_not_change_where_the_surface_moves_by_nothing(tmp_path: Path) -> None:
    mesh = wall(1.2, 0.9, 0.02)
    noise = 1e-9 * np.random.default_rng(1).standard_normal(mesh.vertices.shape)
    original = divide(element(tmp_path / "a", mesh))
    there = divide(element(tmp_path / "b", TriangleMesh(mesh.vertices + noise, mesh.faces)))
    assert list(original) == list(there)
    for name in original:
        if name.endswith(".yaml"):
            assert original[name] == there[name]
    assert original["panels.csv"] == there["panels.csv"]


def test_the_same_file_gives_the_same_bytes(tmp_path: Path) -> None:
    path = element(tmp_path)
    assert divide(path) == divide(path)


def test_an_element_in_another_frame_is_divided_alike(tmp_path: Path) -> None:
    """A wall that stands upright in its file, its plane found: x is level, as in the flat one."""
    mesh = wall(1.2, 0.9, 0.02)
    upright = TriangleMesh(mesh.vertices[:, [0, 2, 1]] * [1, -1, 1], mesh.faces)
    flat, stood = divide(element(tmp_path / "a", mesh)), divide(element(tmp_path / "b", upright))
    assert flat["panels.csv"] == stood["panels.csv"]


def test_a_mirrored_surface_is_thick_to_its_other_side(tmp_path: Path) -> None:
    mesh = wall(1.2, 0.9, 0.02)
    over = divide(element(tmp_path, TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])))
    pose = np.array(json.loads(over["element.json"])["pose"])
    assert pose[2, 2] == -1.0


def hole() -> TriangleMesh:
    mesh = wall(1.2, 0.9, 0.02)
    middle = mesh.vertices[mesh.faces].mean(axis=1)[:, :2]
    return TriangleMesh(mesh.vertices, mesh.faces[np.linalg.norm(middle - [0.5, 0.4], axis=1) > 0.06])


def triangle() -> TriangleMesh:
    mesh = wall(1.2, 0.9, 0.02)
    middle = mesh.vertices[mesh.faces].mean(axis=1)[:, :2]
    return TriangleMesh(mesh.vertices, mesh.faces[middle.sum(axis=1) < 1.5])


def folded_mesh() -> TriangleMesh:
    mesh = wall(1.2, 0.9, 0.02)
    x, y, z = mesh.vertices.T
    return TriangleMesh(
        np.stack([x + 2.0 * np.sin(8.0 * x) * 0.1, y, z + 0.3 * np.cos(8.0 * x)], 1), mesh.faces
    )


def mixed_mesh() -> TriangleMesh:
    mesh = wall(1.2, 0.9, 0.02)
    faces = mesh.faces.copy()
    faces[:100] = faces[:100, ::-1]
    return TriangleMesh(mesh.vertices, faces)


@pytest.mark.parametrize(
    ("mesh", "code"),
    [
        (hole, "element.surface"),
        (triangle, "element.surface"),
        (folded_mesh, "element.surface"),
        (mixed_mesh, "mesh.orientation"),
    ],
)
def test_surfaces_that_are_none_are_refused_with_their_place(tmp_path: Path, mesh: Any, code: str) -> None:
    issue = refusal(element(tmp_path, mesh()))
    assert issue.code == code
    assert is_input_error([issue])
    assert element_file.read_element(
        element(tmp_path, wall(1.2, 0.9, 0.02))
    )  # closed, squared, unified: good


def test_feet_are_refused_where_the_wall_would_be_too_long(tmp_path: Path) -> None:
    """A building part longer than any cell is refused: 1200 inches are 30 m."""
    issue = refusal(element(tmp_path, surface={"mesh": {"file": "wall.obj", "unit": "ft"}}))
    assert issue.code == "mesh.unit"
    assert element_file.read_element(element(tmp_path, surface={"mesh": {"file": "wall.obj", "unit": "in"}}))


def test_noise_is_out_of_tolerance_and_the_tolerance_advised_is_enough(tmp_path: Path) -> None:
    mesh = wall(1.2, 0.9, 0.02)
    mesh.vertices[:, 2] += 4e-4 * np.random.default_rng(2).standard_normal(len(mesh.vertices))
    tight = {"tolerance_mm": 0.3, "cells": [6, 5]}
    issue = refusal(element(tmp_path, mesh, panels={"elastic": tight}))
    assert issue.code == "element.tolerance"
    assert "noisy" in str(issue.hint)
    smooth = wall(1.2, 0.9, 0.02)
    issue = refusal(element(tmp_path, smooth, panels={"elastic": {"tolerance_mm": 0.05, "cells": [2, 2]}}))
    assert issue.code == "element.tolerance"


@pytest.mark.long
def test_blocks_too_thin_are_refused_with_the_thickness_that_fits(tmp_path: Path) -> None:
    thin = [{"size_mm": [700, 500, 85]}]
    issue = refusal(element(tmp_path, blocks=thin))
    assert issue.code == "element.block"
    assert "the cell" in issue.message
    fits = advised_value(issue, r"thickness_mm: (\d+) would fit")
    assert fits < 50
    assert divide(element(tmp_path, blocks=thin, thickness_mm=fits))
    size = re.search(r"a block of (\d+) x (\d+) x (\d+) mm", str(issue.hint))
    assert size is not None
    one = [*thin, {"size_mm": [float(v) for v in size.groups()]}]
    assert divide(element(tmp_path, blocks=one))


def test_wires_too_short_are_refused_with_the_length_that_reaches(tmp_path: Path) -> None:
    def wire(length: float) -> list[dict[str, Any]]:
        own = {"material": "spring_steel", "diameter_mm": 2.0, "temperature_c": 300}
        return [{**own, "lengths_mm": [length]}]

    issue = refusal(element(tmp_path, wires=wire(300)))
    assert issue.code == "element.wire"
    assert divide(element(tmp_path, wires=wire(advised_value(issue, r"a wire of (\d+) mm"))))


def test_one_cell_is_one_panel_where_everything_fits_and_else_refused(tmp_path: Path) -> None:
    small = wall(0.3, 0.24, 0.02)
    one = {"elastic": {"tolerance_mm": 1.0, "cells": [1, 1]}}
    plane = {"normal": [0, 0, 1], "along": [1, 0, 0]}  # the piece leans: its rectangle is that of the wall
    mesh = {"mesh": {"file": "wall.obj", "unit": "mm"}, "plane": plane}
    files = divide(element(tmp_path, small, panels=one, surface=mesh))
    assert [name for name in files if name.endswith(".yaml")] == ["panels/A01.yaml"]
    assert refusal(element(tmp_path, panels=one)).code == "element.wire"
    much = refusal(element(tmp_path, panels={"elastic": {"tolerance_mm": 1.0, "cells": [100000, 1]}}))
    assert much.code == "problem.field"
    assert much.field == "panels.elastic.cells.0"


def test_a_thickness_that_folds_over_is_refused(tmp_path: Path) -> None:
    assert refusal(element(tmp_path, thickness_mm=1500)).code == "part.offset"


def jobs(*ranges: list[float] | None) -> list[dict[str, Any]]:
    return [{"problem": "faces.yaml", **({} if r is None else {"when": {"longest_mm": r}})} for r in ranges]


def test_templates_that_overlap_or_leave_a_panel_out_are_refused_by_panel(tmp_path: Path) -> None:
    for given in (jobs([0, 600], [300, 2000]), jobs([0, 10]), jobs(None, [0, 2000])):
        issue = refusal(element(tmp_path, jobs=given))
        assert issue.code == "element.jobs"
        assert re.search(r"panel [A-Z]\d\d", issue.message)
    files = divide(element(tmp_path, jobs=jobs([0, 400], [400, 2000])))
    assert "panels/A01.yaml" in files


def test_a_template_is_the_rest_of_a_problem(tmp_path: Path) -> None:
    path = element(tmp_path)
    template = tmp_path / "faces.yaml"
    data = yaml.safe_load(template.read_text())
    for wrong in ({"part": {}}, {"stock": {"size_mm": [1, 1, 1]}}, {"operations": None}):
        template.write_text(yaml.safe_dump({**data, **wrong}))
        issue = refusal(path)
        assert issue.code == "element.jobs"
        assert issue.field == "jobs.0"
    template.write_text(yaml.safe_dump(data))
    assert element_file.read_element(path)


@pytest.mark.long
def test_joints_beyond_the_step_asked_are_told_and_the_step_advised_is_kept(tmp_path: Path) -> None:
    def divide_with_joint(joint: float) -> tuple[Issue, ...]:
        elastic_part = {"tolerance_mm": 1.0, "cells": [6, 5], "joint_mm": joint, "check": "none"}
        return run_element(
            ElementRequest(element(tmp_path, panels={"elastic": elastic_part}), tmp_path / "out")
        )

    (issue,) = [item for item in divide_with_joint(0.01) if item.code == "element.joint"]
    again = divide_with_joint(advised_value(issue, r"joint_mm: ([\d.]+)"))
    assert "element.joint" not in {item.code for item in again}


@pytest.mark.long
def test_panels_that_no_wire_holds_are_named_and_more_lengths_help(tmp_path: Path) -> None:
    """A thin wire far longer than its panels snaps; one as long as they need does not."""
    own = {"material": "spring_steel", "diameter_mm": 2.0, "temperature_c": 300}

    def divide_with_lengths(lengths: list[float]) -> dict[str, Issue]:
        path = element(tmp_path, wires=[{**own, "lengths_mm": lengths}])
        return {item.code: item for item in run_element(ElementRequest(path, tmp_path / "out"))}

    issue = divide_with_lengths([2000])["element.held"]
    named = re.findall(r"[A-Z]\d\d", issue.message)
    rows = list(csv.DictReader((tmp_path / "out" / "panels.csv").open()))
    assert named == [row["id"] for row in rows if row["wire_held"] == "no"]
    more = divide_with_lengths([600, 700, 800, 900, 2000])
    left = re.findall(r"[A-Z]\d\d", more["element.held"].message) if "element.held" in more else []
    assert len(left) < len(named)


def test_panels_that_their_check_refuses_are_struck_off(tmp_path: Path) -> None:
    """Of a piece of the wall, whose best division in two has a panel that a wire of 1.2 m cannot cut."""
    mesh = wall(0.8, 0.6, 0.02)
    wires = [
        {"material": "spring_steel", "diameter_mm": 2.0, "lengths_mm": [800, 1200], "temperature_c": 300}
    ]
    for check in ("none", "wire"):
        panels = {"elastic": {"tolerance_mm": 1.0, "cells": [4, 3], "check": check}}
        path = element(tmp_path / check, mesh, wires=wires, panels=panels)
        issues = run_element(ElementRequest(path, tmp_path / check / "out"))
    assert "element.held" not in {issue.code for issue in issues}
    rows = list(csv.DictReader((tmp_path / "wire" / "out" / "panels.csv").open()))
    assert {row["check"] for row in rows} == {"ok"}
    for row in rows:
        require_valid_targets(tmp_path / "wire" / "out" / "panels" / f"{row['id']}.yaml")
    drafted = list(csv.DictReader((tmp_path / "none" / "out" / "panels.csv").open()))
    assert {row["check"] for row in drafted} == {""}
    assert len(drafted) <= len(rows)


@pytest.mark.long
def test_panels_that_nothing_avoids_are_named_with_what_refuses_them(tmp_path: Path) -> None:
    """A wire far longer than all panels snaps in each of them."""
    own = {"material": "spring_steel", "diameter_mm": 2.0, "temperature_c": 300, "lengths_mm": [2000]}
    panels = {"elastic": {"tolerance_mm": 1.0, "cells": [2, 1], "check": "wire"}}
    plane = {"normal": [0, 0, 1], "along": [1, 0, 0]}
    surface = {"mesh": {"file": "wall.obj", "unit": "mm"}, "plane": plane}
    path = element(tmp_path, wall(0.6, 0.3, 0.02), wires=[own], panels=panels, surface=surface)
    issues_by_code = {item.code: item for item in run_element(ElementRequest(path, tmp_path / "out"))}
    rows = list(csv.DictReader((tmp_path / "out" / "panels.csv").open()))
    refused = {row["id"]: row["check"] for row in rows if row["check"] != "ok"}
    assert refused
    assert all(f"{name} ({code})" in issues_by_code["element.held"].message for name, code in refused.items())
    for name, code in refused.items():
        with pytest.raises(TandemError) as caught:
            require_valid_targets(tmp_path / "out" / "panels" / f"{name}.yaml")
        assert code in {issue.code for issue in caught.value.issues}


def test_wrong_fields_are_told_with_their_lines(tmp_path: Path) -> None:
    path = element(tmp_path, thickness=3, wires=[])
    with pytest.raises(TandemError) as caught:
        element_file.read_element(path)
    result = {issue.field: issue for issue in caught.value.issues}
    assert set(result) == {"thickness", "wires"}
    assert all(issue.line for issue in result.values())


@pytest.mark.long
def test_the_facade_among_the_problems_divides(tmp_path: Path) -> None:
    issues = run_element(ElementRequest(ROOT / "problems" / "wave_facade" / "element.yaml", tmp_path))
    assert "element.held" not in {issue.code for issue in issues}
    data = json.loads((tmp_path / "element.json").read_text())
    assert len(data["panels"]) <= 40
    assert max(panel["off_surface_mm"] for panel in data["panels"]) <= 1.0


@pytest.mark.long
@pytest.mark.parametrize(
    ("cells", "wire", "along"),
    [
        ((14, 16, 10, 13), 700.0, 0),
        pytest.param((2, 4, 12, 16), 1000.0, 1, marks=pytest.mark.long),
        ((10, 11, 13, 16), 900.0, 1),
    ],
)
def test_panels_of_the_facade_with_little_room_are_accepted_by_their_check(
    cells: tuple[int, int, int, int], wire: float, along: int, tmp_path: Path
) -> None:
    """The wrists of the first have little room anywhere; sections of the others end early at corners, where
    the wire was moved along itself until one of its ends was in the block."""
    facade = element_file.read_element(ROOT / "problems" / "wave_facade" / "element.yaml")
    assert isinstance(facade, element_file.ElasticElement)
    made = elastic.prepare_division(facade.surface, facade.cells, facade.rules)
    way = 2 * [own.length_mm for own in facade.wires].index(wire) + along
    panel = elastic._fit_panel(made, cells, way)
    assert panel is not None
    assert panel.held
    for name, text in panel_files(facade, (panel,), ("A01",)).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    issues = pipeline.check(pipeline.load(tmp_path / "panels" / "A01.yaml"), advise=False)
    assert not has_errors(issues), issues


@pytest.mark.long
def test_all_panels_of_the_facade_are_accepted_and_a_fifth_is_planned_and_proven(tmp_path: Path) -> None:
    """Planning and proving all panels takes 18 minutes of processor time."""
    out, run = tmp_path / "facade", tmp_path / "run"
    issues = run_element(ElementRequest(ROOT / "problems" / "wave_facade" / "element.yaml", out))
    assert "element.held" not in {issue.code for issue in issues}
    data = json.loads((out / "element.json").read_text())
    assert max(panel["off_surface_mm"] for panel in data["panels"]) <= 1.0
    steps = np.concatenate([[joint["step_95_mm"], joint["step_largest_mm"]] for joint in data["joints"]])
    assert steps.max() <= 0.5
    files = tuple(out / "panels" / f"{panel['id']}.yaml" for panel in data["panels"])
    for file in files:
        assert not has_errors(pipeline.check(pipeline.load(file), advise=False)), file.stem
    planned = files[::5]
    run_batch(Batch(planned, run, workers=1, reports="failed"))
    states = [row["state"] for row in csv.DictReader((run / "summary.csv").open())]
    assert "unproven" not in states
    assert states.count("verified") >= 0.95 * len(planned)


def test_an_element_much_smaller_than_its_wires_is_asked_for_its_unit(tmp_path: Path) -> None:
    """Inches stated as millimetres were fitted for minutes, by wires with loose ends of fifty sections."""
    file = element(tmp_path)
    spec = yaml.safe_load(file.read_text())
    mesh = tmp_path / spec["surface"]["mesh"]["file"]
    lines = [line.split() for line in mesh.read_text().splitlines()]
    small = [["v", *(f"{float(word) / 25.4:.6f}" for word in w[1:])] if w[:1] == ["v"] else w for w in lines]
    mesh.write_text("".join(" ".join(words) + "\n" for words in small))
    with pytest.raises(TandemError) as caught:
        element_file.read_element(file)
    (issue,) = caught.value.issues
    assert issue.code == "element.surface"
    assert "state the correct unit" in str(issue.hint)
