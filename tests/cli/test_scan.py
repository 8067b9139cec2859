"""``tandem scan-fit`` and ``adjust``: a dish between two tools, measured, formed again and proven.

Also the proof's issues for wrong adjustment files and for other scans.
"""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import planner
from planner import pipeline
from planner.cli.scan import Adjust, ScanFit, ScanOptions, run_adjust, run_scan_fit
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.issues import TandemError
from planner.pipeline import Outcome
from planner.processes import registry
from planner.processes.forming.proof.forming_facts import FORMING
from planner.processes.forming.proof.rules import springback
from planner.proof.context import Context
from planner.shopfloor.scan import cloud
from tests import small_forming
from tests.processes.forming.plan.springback import springback_files as files
from tests.shopfloor.scan.synthetic_scan import make_scan, write_marks, write_ply
from tests.test_whole_forming import UPRIGHT


def require_return(q: FloatArray) -> FloatArray:
    """0.6 mm where a dish of 6 mm in a sheet of 1 mm is deepest, more on one side."""
    depth = np.clip((1.0 * MM - q[:, 2]) / (6.0 * MM), 0.0, 1.0)
    return np.asarray(depth * (0.6 * MM + 5.0 * MM * q[:, 1]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dish's problem as a result folder has it, a scan of what came of it, and its marks."""
    root = tmp_path_factory.mktemp("scanned")
    data = small_forming.problem("dsif", force_n=500, tangent_deg=3)
    data["sheet"]["place"] = UPRIGHT
    problem = planner.load(small_forming.write(root, data, small_forming.dish(around=120)))
    pipeline.save(problem, root / "out" / "problem")
    assert problem.part is not None
    assert problem.part.formed is not None
    sample = make_scan(problem.part.formed.mesh, problem.stock.size, require_return, 1, along_z=True)
    write_ply(root / "part 1.ply", sample.points)
    write_marks(root / "marks.csv", sample)
    return root


def read_adjustment(folder: Path, output: Path, **more: Any) -> tuple[Any, ...]:
    options = ScanOptions(marks=folder / "marks.csv")
    return run_adjust(Adjust(folder / "out", folder / "part 1.ply", options, output, **more))


@pytest.fixture(scope="module")
def outcome(folder: Path) -> Outcome:
    """The next dish, planned."""
    read_adjustment(folder, folder / "next" / "next.yaml", page=folder / "page.html")
    return planner.plan(planner.load(folder / "next" / "next.yaml"))


def test_what_a_scan_is_off_is_printed_and_written(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ScanOptions(marks=folder / "marks.csv")
    issues = run_scan_fit(ScanFit(folder / "out", folder / "part 1.ply", options, tmp_path / "off.csv"))
    assert {issue.code for issue in issues} == {"scan.stray"}
    text = capsys.readouterr().out
    assert "4 marks" in text
    assert "scan minus nominal face" in text
    with (tmp_path / "off.csv").open() as table:
        rows = list(csv.DictReader(table))
    floor = [float(r["off_mm"]) for r in rows if float(r["z_mm"]) < -4.9 and r["off_mm"]]
    assert 0.55 < float(np.median(floor)) < 0.65
    run_scan_fit(ScanFit(folder / "out", folder / "part 1.ply", options, tmp_path / "off.html"))
    page = (tmp_path / "off.html").read_text()
    assert "Deviation of the scan from the nominal face" in page
    assert "part 1.ply" in page


def test_the_next_part_is_planned_and_proven_and_says_from_which_scan(outcome: Outcome, folder: Path) -> None:
    assert outcome.verified, outcome.issues
    (told,) = (issue for issue in outcome.issues if issue.code == "forming.compensated")
    assert "part 1.ply" in told.message
    assert 0.5 < told.value < 1.0
    (rule,) = (item for item in outcome.proof.rules if item.code == "verify.springback")
    assert rule.ran
    assert 0.0 < rule.worst < 100.0
    page = (folder / "page.html").read_text()
    assert "Predicted depth deficit of the next part" in page
    before, foretold, _ = re.findall(r'<text x="356" y="14">([\d.]+) mm', page)
    assert before == foretold  # on one scale
    operation = yaml.safe_load((folder / "next" / "next.yaml").read_text())["operations"][0]
    # the problem stands alone: both files lie beside it
    for name in (operation["springback"]["file"], operation["springback"]["scan"]["file"]):
        assert (folder / "next" / name).is_file()


def test_a_second_round_goes_on_from_the_first(outcome: Outcome, folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "next", tmp_path / "out" / "problem")
    (tmp_path / "out" / "problem" / "next.yaml").rename(tmp_path / "out" / "problem" / "problem.yaml")
    problem = pipeline.load_result(tmp_path / "out")
    assert problem.part is not None
    assert problem.part.formed is not None
    rest = make_scan(
        problem.part.formed.mesh, problem.stock.size, lambda q: 0.2 * require_return(q), 2, along_z=True
    )
    options = ScanOptions(marks=write_marks(tmp_path / "marks.csv", rest))
    scan = write_ply(tmp_path / "part 2.ply", rest.points)
    run_adjust(Adjust(tmp_path / "out", scan, options, tmp_path / "third.yaml"))
    (job,) = registry.jobs(planner.load(tmp_path / "third.yaml"))
    (way,) = job.read_compensation().paths
    (before,) = registry.jobs(problem)[0].read_compensation().paths
    assert 1.1 < way.shift.max() / before.shift.max() < 1.3


# ---- faults of the file, of the scan, of the planner ----


@pytest.fixture(scope="module")
def context(outcome: Outcome) -> Context:
    claims = {job.operation.name: job.claims() for job in registry.jobs(outcome.problem)}
    return Context(outcome.problem, claims, outcome.programs)


def springback_spec(context: Context) -> Any:
    return context.problem.operations[0].springback


@pytest.fixture
def restored_files(context: Context) -> Iterator[tuple[Path, Path]]:
    """The file of adjustments and the scan, which are as they were afterwards."""
    both = Path(springback_spec(context).file), Path(springback_spec(context).scan.file)
    before = [path.read_bytes() for path in both]
    yield both
    for path, content in zip(both, before, strict=True):
        path.write_bytes(content)


def messages(context: Context) -> list[str]:
    context.release(FORMING)  # which has read the files
    return [issue.message for issue in springback.check_springback(context).issues]


def move_sheet(x: float, z: float) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        data["scan"]["pose"][0][3] += x
        data["scan"]["pose"][2][3] += z

    return change


def mirror_sheet(data: dict[str, Any]) -> None:
    data["scan"]["pose"][0] = [-v for v in data["scan"]["pose"][0]]


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(
    ("change", "named"),
    [
        (files.negate_springback, "a shift out of the sheet"),
        (files.steep, "changes too fast"),
        (files.short, "off the path of the springback file"),
        (files.each_point(lambda p: p.__setitem__(3, 0.6 * p[3])), "shifts of the scanned part give"),
        (lambda data: data.update(gain=0.6), "shifts of the scanned part give"),
        (lambda data: data.update(gain=-1.0), "its gain or the face of its scan is invalid"),
        (lambda data: data.update(adjusts=[]), "leaves it as it was"),
        (lambda data: data.update(before=data["passes"]), "shifts of the scanned part give"),
        (move_sheet(0.0, 0.3 * MM), "the flat of its scan is 0.3"),
        (move_sheet(0.4 * MM, 0.0), "farther from its marks than the best fit"),
        (mirror_sheet, "no rotation and translation"),
        (lambda data: data["scan"].update(marks=[]), "farther from its marks"),
        (lambda data: data["scan"].update(face="bottom"), "the flat of its scan"),
        (lambda data: data["scan"].update(unit_m=1.0), "the flat of its scan"),
        (lambda data: data["belongs_to"].update(part="0" * 32), "of another job: part"),
        (lambda data: data["passes"][0].update(name="f2"), "has the passes ['f2']"),
    ],
)
def test_what_is_wrong_in_a_file_is_found(
    context: Context, restored_files: Any, change: Any, named: str
) -> None:
    file, _ = restored_files
    file.write_text(files.edited(file.read_text(), change))
    assert any(named in what for what in messages(context)), messages(context)


def test_another_scan_is_found_though_its_digest_is_put_right(
    context: Context, restored_files: Any, folder: Path
) -> None:
    file, scan = restored_files
    formed = context.problem.part.formed  # type: ignore[union-attr]
    other = make_scan(
        formed.mesh, context.problem.stock.size, lambda q: 0.3 * require_return(q), 1, along_z=True
    )
    write_ply(scan, other.points)
    assert messages(context) == [f"dish: {scan.name}: its scan is not the file from which it was made"]
    with pytest.raises(TandemError, match="was made from the scan"):
        registry.jobs(planner.load(folder / "next" / "next.yaml"))[0].read_compensation()
    digest = cloud.read(scan, MM).digest
    file.write_text(files.edited(file.read_text(), lambda data: data["scan"].update(sha256=digest)))
    assert any("shifts of the scanned part give" in what for what in messages(context))
    scan.unlink()
    assert "cannot be read" in messages(context)[0]


def test_an_adjustment_without_its_scan_is_refused(folder: Path, outcome: Outcome, tmp_path: Path) -> None:
    shutil.copytree(folder / "next", tmp_path / "next")
    path = tmp_path / "next" / "next.yaml"
    data = yaml.safe_load(path.read_text())
    data["operations"][0]["springback"].pop("scan")
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError, match="name adjustments with their scan"):
        registry.jobs(planner.load(path))[0].read_compensation()


def test_a_scan_that_lies_beside_its_part_is_measured_with_a_warning_and_not_adjusted_by(
    folder: Path, tmp_path: Path
) -> None:
    """No marks, two millimetres beside: `scan-fit` says what that hides, `adjust` moves no target."""
    formed = pipeline.load_result(folder / "out").part.formed  # type: ignore[union-attr]
    sample = make_scan(
        formed.mesh, np.array([200.0, 200.0, 1.0]) * MM, require_return, 3, 40_000, turn=(0.0, 0.0, 0.0)
    )
    scan = write_ply(tmp_path / "beside.ply", sample.points + sample.pose[:3, 3] + [0.002, 0.0, 0.0])
    issues = run_scan_fit(ScanFit(folder / "out", scan, ScanOptions()))
    assert "scan.no_marks" in {issue.code for issue in issues}
    with pytest.raises(TandemError, match="three marks or more") as error:
        run_adjust(Adjust(folder / "out", scan, ScanOptions(), tmp_path / "next.yaml"))
    (issue,) = error.value.issues
    assert issue.code == "scan.no_marks"
    assert 1.5 < issue.value < 2.5
    assert not (tmp_path / "next.yaml").exists()


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        ({"gain": 2.0}, "forming.loop_law", "allowed 0.1 to 1.2"),
        ({"page": Path("page.pdf")}, "output.folder", ".html"),
        ({"operation": "cone"}, "forming.no_sheet", "forming operations: dish"),
    ],
)
def test_requests_that_cannot_be_met_are_refused(
    folder: Path, tmp_path: Path, more: dict[str, Any], code: str, words: str
) -> None:
    with pytest.raises(TandemError, match=words) as error:
        read_adjustment(folder, tmp_path / "a.yaml", **more)
    assert error.value.issues[0].code == code


def test_a_problem_of_the_users_own_is_not_written_over(folder: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("tandem: 1\n")
    with pytest.raises(TandemError, match="is not a problem with a springback"):
        read_adjustment(folder, mine)
    assert mine.read_text() == "tandem: 1\n"
