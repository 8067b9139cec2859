"""The content of the page without a browser: policy, bundled problems, pictures, and the package."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from planner import pipeline
from planner.geometry.arrays import Mesh
from planner.report import view3d
from planner.service import bundled_examples
from planner.service.app import PAGE_FOLDER, STATIC
from planner.service.upload_reader import decimate, examine_element, path_bars, shapes
from tests import small_problem
from tests.service.support import ROOT as REPOSITORY
from tests.service.support import TABLE, InProcess

PAGES = ["/", "/ui/new", "/ui/elements", "/ui/compare", "/ui/login"]
PAGES += [f"/ui/{kind}/{'0' * 32}" for kind in ("jobs", "elements")]


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    with InProcess(tmp_path_factory.mktemp("page") / "data", examiners=1) as made:
        yield made


class Markup(HTMLParser):
    """Collects what a strict policy would block, the fetched URLs, and controls without a name."""

    def __init__(self) -> None:
        super().__init__()
        self.inline: list[str] = []
        self.fetched: list[str] = []
        self._script = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self._script = tag == "script" and "src" not in given
        self.inline += [name for name in given if name.startswith("on") or name == "style"]
        self.inline += [tag] if tag == "style" else []
        self.fetched += [str(given[key]) for key in ("src", "href") if key in given]

    def handle_data(self, data: str) -> None:
        if self._script and data.strip():
            self.inline.append(data)


@pytest.mark.parametrize("path", PAGES)
def test_pages_run_their_own_files_alone(running_service: InProcess, path: str) -> None:
    answer = running_service.http.get(path)
    assert answer.status_code == 200
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    markup = Markup()
    markup.feed(answer.text)
    assert not markup.inline
    for place in markup.fetched:
        assert place.startswith(("/", "#")), f"{path} needs the internet for {place}"
        if place.startswith("/ui/static/"):
            assert running_service.http.get(place).status_code == 200, place


def test_scripts_make_no_markup_of_text_and_fetch_nothing_from_elsewhere() -> None:
    for path in (*STATIC.glob("*.js"), *view3d.FOLDER.glob("*.js")):
        text = path.read_text("utf-8")
        for word in (
            "innerHTML",
            "outerHTML",
            "insertAdjacentHTML",
            "document.write",
            "eval(",
            "new Function",
        ):
            assert word not in text, f"{path.name}: {word}"
        urls = set(re.findall(r"https?://[^\"'` ]+", text)) - {"http://www.w3.org/2000/svg"}
        assert not urls, f"{path.name}: {urls}"
        for name in re.findall(r'from "(\./[^"]+)"', text):
            result = [folder for folder in (STATIC, view3d.FOLDER) if (folder / name).is_file()]
            assert len(result) == 1, f"{path.name}: {name}"


def test_vendored_scripts_have_their_licence_beside_them() -> None:
    vendored = [path for folder in (STATIC, view3d.FOLDER) for path in (folder / "vendor").glob("*.*js")]
    assert len(vendored) == 3
    for path in vendored:
        licence = path.with_name(f"{path.name.partition('.')[0]}.LICENSE.txt")
        assert "Permission is hereby granted" in licence.read_text("utf-8")


def test_what_draws_cells_imports_nothing_but_its_own_files() -> None:
    for path in (view3d.FOLDER / "vendor").glob("three.*.js"):
        text = path.read_text("utf-8")
        for name in re.findall(r"""(?:\bfrom|\bimport)\s*\(?["']([\w./:@-]+)["']""", text):
            assert (path.parent / name).is_file(), f"{path.name}: {name}"
        assert "eval(" not in text and "new Function" not in text and "sourceMappingURL" not in text


@pytest.mark.parametrize(
    "path",
    [
        "/ui/static/../routes.py",
        "/ui/static/%2e%2e/routes.py",
        "/ui/static/none.css",
        "/ui/none",
        "/ui/static/",
    ],
)
def test_what_is_no_page_is_404(running_service: InProcess, path: str) -> None:
    answer = running_service.http.get(path)
    assert answer.status_code == 404
    assert answer.json()["issues"][0]["code"] == "service.not_found"


def test_pages_are_no_part_of_the_api(running_service: InProcess) -> None:
    assert not [
        path for path in running_service.http.get("/openapi.json").json()["paths"] if path.startswith("/ui")
    ]


def test_bundled_problems_need_a_token_where_others_do(tmp_path: Path) -> None:
    from planner.service.models import Database, default_url
    from planner.service.security import Auth

    data = tmp_path / "data"
    data.mkdir()
    Auth(Database(default_url(data))).create_token("ann")
    with InProcess(data, require_token=True, examiners=1) as closed:
        for path in (
            "/ui/examples",
            "/ui/example-elements",
            "/ui/example?name=wing",
            "/ui/example/file?name=cone_spif&file=cone.ply",
        ):
            assert closed.http.get(path).status_code == 401
        assert closed.http.get("/").status_code == 200


@pytest.mark.parametrize("name", sorted(bundled_examples.problems()))
def test_every_bundled_problem_is_data_with_its_files(name: str) -> None:
    result = bundled_examples.problem(name)
    assert result["problem"]["tandem"] == 1  # a template is none
    assert isinstance(result["problem"]["cell"], dict)
    assert result["problem"]["operations"]
    for file in result["files"]:
        assert bundled_examples.file(name, file).is_file()
    assert "make_" not in bundled_examples.problems()[name]["about"]


@pytest.mark.parametrize("name", sorted(bundled_examples.elements()))
def test_every_bundled_element_is_read_out_of_its_files_alone(name: str, tmp_path: Path) -> None:
    result = bundled_examples.elements()[name]
    uploads = {file: bundled_examples.file(name, file) for file in result["files"]}
    (tmp_path / "read").mkdir()
    read = examine_element(tmp_path / "read", uploads.pop(result["file"]), uploads, 10_000_000, {})
    assert read.issues == ()
    assert read.summary["kind"] == result["kind"]
    assert "tandem element" not in result["about"]


def test_bundled_files_are_those_that_problems_name(running_service: InProcess) -> None:
    for file in ("problem.yaml", "../cells/irb140_ball.yaml", "/etc/passwd", "expect.yaml"):
        answer = running_service.http.get("/ui/example/file", params={"name": "cone_spif", "file": file})
        assert answer.status_code == 404
        answer = running_service.http.get("/ui/example/file", params={"name": "dome_267", "file": file})
        assert answer.status_code == 404
    assert running_service.http.get("/ui/example", params={"name": "../planner"}).status_code == 404
    assert running_service.http.get("/ui/example", params={"name": "dome_267"}).status_code == 404


def test_a_preview_has_the_shapes_and_their_size(running_service: InProcess) -> None:
    answer = running_service.post(path="/ui/preview")
    assert answer.status_code == 200
    way, block = answer.json()["shapes"]
    vertices = np.array(block["vertices"]).reshape(-1, 3)
    assert np.ptp(vertices, axis=0).tolist() == [100.0, 100.0, 100.0]
    assert (way["name"], way["kind"]) == ("poses, left", "path")
    bars = np.array(way["vertices"]).reshape(-1, 8, 3)
    assert bars.mean(axis=1).tolist() == [[0.0, y, 500.0] for y in range(-40, 41, 20)]
    assert (
        running_service.http.post(
            "/ui/preview", files=[("problem", ("p", "a: 1")), ("files", ("t.csv", TABLE))]
        ).status_code
        == 422
    )


def test_the_picture_of_a_part_is_as_large_as_the_part() -> None:
    problem = pipeline.load("cone_spif")
    assert problem.part is not None
    assert problem.part.formed is not None
    body = next(body for body in shapes(problem)[0] if body["kind"] == "part")
    expected = problem.part.formed.mesh.vertices * 1e3
    got = np.array(body["vertices"]).reshape(-1, 3)
    np.testing.assert_allclose(np.ptp(got, axis=0), np.ptp(expected, axis=0), rtol=0.02)


def test_a_fault_of_a_table_shows_before_planning(running_service: InProcess) -> None:
    files = [("problem", ("p.yaml", small_problem.PROBLEM)), ("files", ("targets.csv", TABLE[:-3]))]
    answer = running_service.http.post("/ui/preview", files=files)
    assert answer.status_code == 200
    assert not answer.json()["ok"]
    assert [issue["code"] for issue in answer.json()["issues"]] == ["targets.file"]


def test_a_way_is_drawn_as_bars_of_its_length() -> None:
    """Against the volume of square bars, 2 mm wide."""
    import trimesh

    made = path_bars(np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0, 0], [0.1, 0.2, 0.1]]), 0.002)
    body = trimesh.Trimesh(made.vertices, made.faces, process=False)
    assert abs(body.volume) == pytest.approx((0.1 + np.hypot(0.2, 0.1)) * 0.002**2)


def test_a_large_mesh_is_thinned_and_keeps_its_shape() -> None:
    """Against the sphere's own area and radius."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=7, radius=0.1)
    thin = decimate(Mesh(np.asarray(sphere.vertices), np.asarray(sphere.faces)), max_triangles=30_000)
    assert 2_000 < len(thin.faces) <= 30_000
    made = trimesh.Trimesh(thin.vertices, thin.faces, process=False)
    assert made.area == pytest.approx(4 * np.pi * 0.01, rel=0.02)
    assert np.linalg.norm(thin.vertices, axis=1) == pytest.approx(0.1, rel=0.02)


def test_templates_styles_and_scripts_travel_in_the_wheel(tmp_path: Path) -> None:
    """The wheel is built by the very builder that pyproject.toml names."""
    builder = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is not installed")
    (made,) = builder.WheelBuilder(str(REPOSITORY)).build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(made) as wheel:
        inside = set(wheel.namelist())
    for path in (*(PAGE_FOLDER / "templates").iterdir(), *STATIC.rglob("*"), *view3d.FOLDER.rglob("*")):
        if path.is_file() and path.suffix != ".pyc":
            assert path.relative_to(REPOSITORY).as_posix() in inside
