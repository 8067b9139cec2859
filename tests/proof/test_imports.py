"""The proof shares with the planner exactly the modules in the table of docs/proof.md."""

from __future__ import annotations

import ast
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "planner"
FOLDERS = (
    *("verify", "proof", "programs"),
    *("processes/*/proof", "languages/*/reader", "languages/*/rules"),
)
"""Folders of the proof: what it needs to read programs, to replay them and to judge their motion."""


@functools.cache
def proof_files() -> dict[str, Path]:
    """Files of the proof by the names of their modules."""
    folders = [folder for pattern in FOLDERS for folder in PACKAGE.glob(pattern)]
    files = [path for folder in folders for path in folder.rglob("*.py")]
    names = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in files
    ]
    return dict(zip(names, files, strict=True))


NEVER = (
    "planner.motion",
    "planner.cell.kinematics",
    "planner.processes.hotwire.plan",
    "planner.processes.forming.plan",
    "planner.processes.milling.plan",
    "planner.languages.writing",
    "planner.report",
)
"""Packages and modules that the proof must not import in any form."""
ROW = re.compile(r"^\| (`planner\.[^|]*) \| [^|]{10,} \|$", re.MULTILINE)


def listed() -> set[str]:
    """Modules in the table of the docs."""
    text = (
        (ROOT / "docs" / "proof.md").read_text("utf-8").split("## What the proof shares")[1].split("\n## ")[0]
    )
    return {name for row in ROW.findall(text) for name in re.findall(r"`([\w.]+)`", row)}


def is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


@functools.cache
def read(path: Path) -> tuple[set[str], set[str], set[str]]:
    """Return the imports of a file, also inside functions, with names and attributes in it."""
    found, names, attributes = set[str](), set[str](), set[str]()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Name):
            names.add(node.id)
        elif isinstance(node, ast.Attribute):
            attributes.add(node.attr)
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: a relative import"
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            inside = {name for name in whole if is_module(name)}
            found |= inside | ({str(node.module)} if inside != whole else set())
    return found, names, attributes


def imported(path: Path) -> set[str]:
    """Modules of Tandem outside of the proof that a file imports."""
    found, _, _ = read(path)
    return {name for name in found if name.split(".")[0] == "planner" and name not in proof_files()}


def all_imported() -> dict[str, set[str]]:
    return {name: imported(path) for name, path in proof_files().items()}


def within(name: str, packages: tuple[str, ...]) -> bool:
    return any(name == package or name.startswith(f"{package}.") for package in packages)


def test_every_import_is_in_the_table_and_every_row_is_used() -> None:
    used = set().union(*all_imported().values())
    assert len(listed()) > 10
    assert sorted(used - listed()) == [], "shared, but not in docs/proof.md"
    assert sorted(listed() - used) == [], "in docs/proof.md, but not shared"


def test_no_kinematics_and_no_solver_of_the_planner() -> None:
    wrong = {file: [m for m in some if within(m, NEVER)] for file, some in all_imported().items()}
    assert {file: some for file, some in wrong.items() if some} == {}


@pytest.mark.parametrize("name", ["importlib", "__import__", "exec", "eval"])
def test_no_import_goes_round_the_table(name: str) -> None:
    for path in proof_files().values():
        _, names, _ = read(path)
        assert name not in names, path.name


def test_the_planners_dimensions_are_only_compared() -> None:
    """``RobotData.form`` is what the planner solves with."""
    users = set()
    for path in proof_files().values():
        _, _, attributes = read(path)
        if attributes & {"form", "opw"}:
            users.add(path.name)
    assert users == {"arm_model.py"}


def test_nothing_of_the_planner_comes_along_in_a_fresh_process() -> None:
    """But for its chain of joints, which the cell bounds distances with: ``verify.kinematics`` holds it
    against Drake."""
    code = "import sys, planner.proof.prove; print(*(m for m in sys.modules if m.startswith('planner')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = done.stdout.split()
    assert "planner.proof.replay.playback" in loaded
    assert [m for m in loaded if within(m, NEVER)] == ["planner.cell.kinematics"]
