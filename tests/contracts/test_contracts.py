"""The imports of the package keep the contracts in ``.importlinter``; see :mod:`tests.contracts`."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import grimp
import pytest

from tests.contracts import __main__ as command
from tests.contracts.exceptions import (
    CONFIG,
    ROOT,
    WRITE_COMMAND,
    Contract,
    find_exceptions,
    import_graph,
    match_modules,
    option_lines,
    read_contracts,
    write_exceptions,
)

SEEDED_IMPORTS = {
    # Floors: upward, between rooms that are independent, and allowed ones.
    "geometry -> cell": {"floors"},
    "issues -> files": {"floors"},
    "catalogue -> reading": {"floors"},
    "pipeline -> service": {"floors"},
    "programs -> languages.krl.reader": {"floors"},
    "proof.rules -> processes.milling.proof": {"floors"},
    "languages.krl.rules -> processes.milling": {"floors"},
    "cell -> geometry": set(),
    "plans -> targets": set(),
    "service -> pipeline": set(),
    # The proof shares nothing with planner and writers.
    "proof.rules -> motion.search": {"proof", "floors"},
    "proof.kinematics -> reading": {"proof"},
    "processes.hotwire.proof.rules -> processes.hotwire.plan.kerf": {"proof"},
    "processes.poses.proof -> reading": {"proof"},
    "processes.milling.proof -> targets": {"proof"},
    "programs -> plans": {"floors", "proof"},
    "languages.rapid.reader -> languages.rapid.writer": {"proof"},
    "languages.urscript.reader -> languages.writing": {"proof", "languages"},
    "languages.krl.rules -> languages.krl.writer": {"proof"},
    "processes.hotwire.proof -> proof": set(),
    # Plans, claims and motion.
    "processes.forming.plan.paths -> processes.forming.proof": {"plan"},
    "processes.hotwire.plan -> proof": {"plan"},
    "processes.milling.plan -> motion": {"plan"},
    "processes.trim.plan -> languages.krl.rules": {"plan", "floors"},
    "processes.trim.plan -> reading": set(),
    "processes.forming.claims -> processes.forming.plan": {"claims"},
    "processes.trim.claims -> processes.trim.proof": {"claims"},
    "processes.hotwire.sentences -> reading": {"claims"},
    "processes.milling.claims -> targets": {"claims"},
    "languages.krl.sentences -> languages.writing": {"claims", "languages"},
    "languages.rapid.sentences -> languages.rapid.reader": {"claims"},
    "processes.poses.claims -> geometry": set(),
    "motion.search -> proof": {"motion"},
    "motion.trajectory -> processes.trim.claims": {"motion", "floors"},
    "motion -> languages.writing": {"motion", "floors"},
    # Writers.
    "languages.krl.writer -> programs": {"writers"},
    "languages.krl.writer -> languages.krl.reader": {"writers"},
    "languages.krl.writer -> languages.krl.rules": {"writers"},
    "languages.writing -> proof": {"writers"},
    "languages.writing -> processes.trim.claims": {"writers", "floors"},
    "languages.rapid.writer -> languages.writing": set(),
    # Processes and languages among themselves.
    "processes.milling.plan -> processes.hotwire.plan": {"processes"},
    "processes.forming.proof -> processes.trim.claims": {"processes"},
    "processes.trim.plan -> processes.milling.plan": {"processes"},
    "processes.trim.plan -> processes.forming.plan": set(),
    "processes.registry -> processes.hotwire.plan": {"processes"},
    "languages.krl.reader -> languages.rapid.reader": {"languages"},
    "languages.writing -> languages.krl.writer": {"languages"},
    # Report.
    "report -> processes.hotwire.proof": {"report", "floors"},
    "report -> languages.rapid.reader": {"report", "floors"},
    "report -> proof": set(),
}
"""Imports between rooms, without ``planner.``, and the contracts that each breaks."""

IMPORT_FORMS = (
    "from {package} import {name}\n",
    "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from {package} import {name}\n",
    "def function():\n    from {package} import {name}\n",
)


def run_linter(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Run import-linter on the package and the contracts in a folder."""
    return subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports_command; lint_imports_command()",
            "--no-cache",
            "--no-logo",
            *options,
        ],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder), "COLUMNS": "400"},  # so that lines are not wrapped
        capture_output=True,
        text=True,
        check=False,
    )


def test_imports_keep_the_contracts() -> None:
    run = run_linter(ROOT)
    if run.returncode:
        note = f"If an exception is obsolete, run `{WRITE_COMMAND}`."
        pytest.fail(f"{run.stdout}{run.stderr}\n{note}", pytrace=False)


@pytest.mark.parametrize("name", sorted(read_contracts()))
def test_each_name_in_a_contract_is_a_module(name: str) -> None:
    """A contract on a room that was renamed would hold for nothing."""
    contract = read_contracts()[name]
    for option in ("source_modules", "forbidden_modules"):
        for expression in option_lines(contract, option):
            assert match_modules(import_graph(), expression), f"{option}: no module is named {expression}"


def copy_packages(folder: Path) -> None:
    """Copy the packages without their content, and the contracts without exceptions.

    Each package gets an empty module ``seeded``.
    """
    for path in (ROOT / "planner").rglob("*.py"):
        copy = folder / path.relative_to(ROOT)
        named = path.name in ("claims.py", "registry.py", "sentences.py") or path.parent == ROOT / "planner"
        if path.name == "__init__.py" or named:
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.touch()
        if path.name == "__init__.py":
            (copy.parent / "seeded.py").touch()
    (folder / "planner" / "seeded.py").unlink()
    (folder / ".importlinter").write_text(CONFIG.read_text(encoding="utf-8"), encoding="utf-8")
    write_exceptions(folder / ".importlinter", dict.fromkeys(read_contracts(), ()))


def seeded_module(folder: Path, name: str) -> str:
    """Return the module that stands for a package or a module without ``planner.``."""
    path = folder / "planner" / name.replace(".", "/")
    return f"planner.{name}.seeded" if path.is_dir() else f"planner.{name}"


def broken_contracts(output: str) -> dict[str, set[str]]:
    """Read the contracts that each import breaks from the output of import-linter."""
    broken: dict[str, set[str]] = {}
    ids = {contract["name"]: name for name, contract in read_contracts().items()}
    names = "|".join(re.escape(str(name)) for name in ids)
    details = output.partition("Broken contracts\n")[2]
    parts = re.split(rf"(?m)^({names})\n-+\n", details)
    for name, part in zip(parts[1::2], parts[2::2], strict=True):
        for line in re.findall(r"(\S+ -> \S+) \(l\.", part):
            broken.setdefault(line, set()).add(ids[name])
    return broken


def test_seeded_imports_break_their_contracts(tmp_path: Path) -> None:
    """At load time, under ``TYPE_CHECKING`` and inside functions; a room without a floor is reported, too."""
    copy_packages(tmp_path)
    expected = {}
    for number, (line, contracts) in enumerate(SEEDED_IMPORTS.items()):
        importer, imported = (seeded_module(tmp_path, name) for name in line.split(" -> "))
        package, _, name = imported.rpartition(".")
        with (tmp_path / f"{importer.replace('.', '/')}.py").open("a", encoding="utf-8") as file:
            file.write(IMPORT_FORMS[number % len(IMPORT_FORMS)].format(package=package, name=name))
        if contracts:
            expected[f"{importer} -> {imported}"] = contracts
    (tmp_path / "planner" / "attic.py").touch()
    run = run_linter(tmp_path)
    assert run.returncode == 1, run.stderr
    assert broken_contracts(run.stdout) == expected
    assert re.search(r"not listed as layers:\s+- planner\.attic\n", run.stdout)


def test_an_exception_without_an_import_is_an_error(tmp_path: Path) -> None:
    copy_packages(tmp_path)
    write_exceptions(tmp_path / ".importlinter", {"report": ["planner.report.seeded -> planner.processes"]})
    run = run_linter(tmp_path, "--contract", "report")
    assert run.returncode == 1
    assert "No matches for ignored import planner.report.seeded -> planner.processes." in run.stdout


def test_the_command_adds_exceptions_only_on_request(tmp_path: Path) -> None:
    config = tmp_path / ".importlinter"
    config.write_text(SMALL_CONFIG)
    graph = grimp.ImportGraph()
    for line in ("p.a.x -> p.b", "p.b.y -> p.a", "p.b.z -> p.a.x", "p.a.r -> p.b.z"):
        importer, imported = line.split(" -> ")
        graph.add_import(importer=importer, imported=imported)
    graph.add_module("p")

    assert command.main([], config, graph) == 1
    assert config.read_text() == SMALL_CONFIG

    assert command.main(["--write"], config, graph) == 1
    removed = SMALL_CONFIG.replace("    p.a.gone -> p.b\n", "").replace(
        "ignore_imports =\n    p.b.w -> p.a\n", ""
    )
    assert config.read_text() == removed

    assert command.main(["--write", "--allow-new"], config, graph) == 0
    added = removed.rstrip("\n") + "\nignore_imports =\n    p.b.y -> p.a\n    p.b.z -> p.a.x\n"
    assert config.read_text() == added
    assert command.main(["--write"], config, graph) == 0
    assert config.read_text() == added


def test_direct_imports_alone_break_a_contract() -> None:
    graph = grimp.ImportGraph()
    graph.add_import(importer="p.a", imported="p.c")
    graph.add_import(importer="p.c", imported="p.b")
    contract: Contract = {"type": "forbidden", "source_modules": "p.a", "forbidden_modules": "p.b"}
    assert not find_exceptions(graph, contract).needed


SMALL_CONFIG = """\
# A comment at the top stays.

[importlinter]
root_package = p

[importlinter:contract:one]
name = a knows not b
type = forbidden
source_modules =
    p.a
forbidden_modules =
    p.b
ignore_imports =
# This comment stays.
    p.a.r -> p.b.**
    p.a.gone -> p.b
    p.a.x -> p.b

# So does this one.
[importlinter:contract:two]
name = a is above b
type = layers
containers = p
layers =
    a
    b
ignore_imports =
    p.b.w -> p.a
"""
