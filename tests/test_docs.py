"""README and docs are correct: commands and code blocks run, links resolve, and tables match the code."""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from tests import small_problem
from tests.service.support import Process

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\(([^)#]*)(?:#([\w-]*))?\)")


def blocks(language: str) -> Iterator[tuple[str, str]]:
    for page in PAGES:
        for found in BLOCK.finditer(page.read_text("utf-8")):
            if found.group(1) == language:
                yield page.name, found.group(2)


def reference() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_reference", ROOT / "docs" / "make_reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that ``pip install .`` puts into site-packages, without dependencies that exist already."""
    folder = tmp_path_factory.mktemp("installed")
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--target",
        str(folder),
        str(ROOT),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return folder


def run(command: list[str], site: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=600
    )


DEAR = ("check problems/wave_wall", "springback cone_spif", "plan wing", "report out")
"""Commands of the README that make test leaves to make test-long: dear ones, and one of which
`tests/batch/test_batch.py` has the exit codes."""
FIRST = "tandem plan column_capital -o out"
"""The first command of the README: two setups, of which make test plans the second one, its faces, in
`tests/test_whole_job.py`."""


@pytest.mark.parametrize("is_fast", [True, pytest.param(False, marks=pytest.mark.long)], ids=["quick", "all"])
def test_the_commands_of_the_readme_run_from_any_folder(site: Path, tmp_path: Path, is_fast: bool) -> None:
    """In make test a smaller bundled problem is planned into ``out``, and checked; the README's own is read
    by its name in `tests/motion/test_toppra_import.py`."""
    where = run([sys.executable, "-c", "import planner; print(planner.__file__)"], site, tmp_path)
    assert Path(where.stdout.strip()).is_relative_to(site), where.stderr
    lines = [line for name, text in blocks("sh") if name == "README.md" for line in text.splitlines()]
    assert lines[:2] == ["pip install .", FIRST]
    assert all(any(line.startswith(f"tandem {dear}") for line in lines) for dear in DEAR)
    if is_fast:
        lines[1:2] = [FIRST.replace("column_capital", "kerf_test"), "tandem check kerf_test"]
    for line in lines[1:]:
        words = shlex.split(line)
        assert words[0] == "tandem"
        if is_fast and " ".join(words[1:]).startswith(DEAR):
            continue
        done = run([sys.executable, "-m", "planner", *words[1:]], site, tmp_path)
        assert done.returncode == 0, f"{line}: {done.stdout}{done.stderr}"
    made = {path.name for path in (tmp_path / "out").iterdir()}
    table = re.findall(r"^\| `([^`]+)`(?:, `([^`]+)`)? \|", (ROOT / "README.md").read_text(), re.MULTILINE)
    named = {name.split("/")[0] for row in table for name in row if name}
    assert named == made


def test_the_python_of_the_readme_runs(site: Path, tmp_path: Path) -> None:
    code = [text for name, text in blocks("python") if name != "service.md"]
    assert code
    for text in code:
        done = run([sys.executable, "-c", text], site, tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith("True ") or "verified" not in text


def test_the_python_of_the_service_runs(site: Path, tmp_path: Path) -> None:
    """Against a service, and with a smaller problem than the wing."""
    (text,) = [text for name, text in blocks("python") if name == "service.md"]
    assert 'planner.load("wing")' in text
    small = small_problem.write(tmp_path)
    served = Process(tmp_path / "data").wait()
    try:
        code = text.replace("http://127.0.0.1:8000", served.url).replace('"wing"', repr(str(small)))
        done = run([sys.executable, "-c", code], site, tmp_path)
    finally:
        served.stop()
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("True ")


def test_the_problem_of_the_reference_page_reads(tmp_path: Path) -> None:
    from planner.pipeline import load

    (example,) = [text for name, text in blocks("yaml") if name == "problem_file.md"]
    path = tmp_path / "problem.yaml"
    path.write_text(example.replace("../cells/", f"{ROOT}/problems/cells/"))
    assert load(path).name == "my_panel"


@pytest.mark.parametrize("name", ["problem_file.md", "proof.md", "batch.md"])
def test_the_tables_are_those_of_the_code(name: str) -> None:
    text = (ROOT / "docs" / name).read_text("utf-8")
    assert reference().page(name, text) == text, "run python docs/make_reference.py"


def test_no_mapping_of_a_problem_file_is_left_out_of_the_reference() -> None:
    from planner.processes.registry import schemas
    from planner.reading.cell import CellFile
    from planner.reading.problem import ProblemFile

    whole = [ProblemFile, CellFile, *schemas().values()]
    asked = {model.__name__ for model in whole}
    for model in whole:
        parts = model.model_json_schema().get("$defs", {})
        asked |= {name for name, part in parts.items() if part.get("type") == "object"}
    assert asked - {model.__name__ for _, _, model in reference().CHAPTERS} == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target, anchor in LINK.findall(page.read_text("utf-8")):
        if target.startswith("http"):
            continue
        path = (page.parent / target) if target else page
        assert path.exists(), f"{page.name}: {target}"
        if anchor:
            text = path.read_text("utf-8")
            headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
            slugs = {re.sub(r"[^\w -]", "", h).strip().lower().replace(" ", "-") for h in headings}
            assert anchor in slugs or f'id="{anchor}"' in text, f"{page.name}: #{anchor}"
