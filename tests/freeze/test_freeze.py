"""Behaviour that a refactoring must not change, held against stored tables; see :mod:`tests.freeze`."""

from __future__ import annotations

import pytest

from planner.service import bundled_examples
from tests.freeze import digests, lists, wordless
from tests.freeze.startup_imports import IMPORTS

FAST = (
    "gauge_lanes",
    "kerf_test",
    "gcode",
    "infeasible/sheet_hole",
    "infeasible/unknown_key",
    "infeasible/wire_too_short",
)
"""Problems that ``make test`` plans in 40 s of processor time: poses and straight wire in RAPID, milling in
KRL, and refusals of forming, elastic wire and the problem file."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in FAST else pytest.mark.long)
        for name in sorted(bundled_examples.problems())
    ],
)
def test_results_of_a_bundled_problem_are_unchanged(name: str) -> None:
    table = digests.read_table()
    if mismatch := digests.environment_mismatch(table["environment"]):
        pytest.skip(f"digests of floating-point results do not apply: this machine has {mismatch}")
    recorded = table["problems"].get(name)
    command = f"`{digests.WRITE_COMMAND} {name}` (all problems: `{digests.WRITE_COMMAND}`)"
    if recorded is None:
        pytest.fail(f"{name} has no stored digests. Run {command}.")
    if changed := digests.differences(recorded, digests.compute(name)):
        listed = "\n  ".join(changed)
        pytest.fail(f"Results of {name} differ:\n  {listed}\nIf the change is intended, run {command}.")


def test_every_stored_problem_is_bundled() -> None:
    removed = sorted(set(digests.read_table()["problems"]) - set(bundled_examples.problems()))
    assert not removed, f"no longer bundled: {removed}; remove their rows or run `{digests.WRITE_COMMAND}`"


def test_proof_rules_keep_their_order() -> None:
    stored = lists.RULE_CODES_FILE.read_text("utf-8").split()
    assert lists.rule_codes() == stored, f"if intended, run `{digests.WRITE_COMMAND} rules`"


@pytest.mark.parametrize("start", lists.STARTS)
def test_start_up_imports_what_is_stored(start: str) -> None:
    """Fewer packages than stored are no failure: they depend on versions of other packages."""
    stored, current = IMPORTS[start], lists.imports(start)
    added = sorted({*current["modules"], *current["packages"]} - {*stored["modules"], *stored["packages"]})
    removed = sorted(set(stored["modules"]) - set(current["modules"]))
    assert not added and not removed, (
        f"`{start}` newly imports {added} and no longer imports {removed}. "
        "Import heavy packages inside the functions that use them. "
        f"If the change is intended, run `{digests.WRITE_COMMAND} imports`."
    )


def test_differences_name_each_file() -> None:
    recorded, current = {"a": "1", "b": "2", "c": "3"}, {"a": "1", "b": "4", "d": "5"}
    assert digests.differences(recorded, current) == ["removed: c", "added: d", "changed: b"]


def test_another_environment_is_named_with_both_versions() -> None:
    recorded = {**digests.environment(), "numpy": "1.0"}
    assert digests.environment_mismatch(digests.environment()) == ""
    assert digests.environment_mismatch(recorded).endswith("(recorded with 1.0)")


@pytest.mark.parametrize(
    ("name", "old", "new", "same"),
    [
        ("a.mod", 'TPWrite "2 mm";  ! old', 'TPWrite "two mm"; ! new words', True),
        ("a.mod", "MoveL p1, v50;", "MoveL p1, v60;", False),
        ("a.mod", "MoveL [[1,2],[3]], v50;", "MoveL [[1,2,3]], v50;", False),
        ("a.mod", "SetDO wire, 1;", "SetDO heater, 1;", True),
        ("a.src", "PTP home ; old", "PTP start ; 3 new", True),
        ("a.nc", "(old 3)\nG1 X2", "(new 4)\nG1 X2", True),
        ("a.nc", "G1 X2", "G1 X3", False),
        ("a.nc", "(old) G1 X2 (end 3)", "(new) G1 X2 (end 4)", True),
        ("a.nc", "(old) G1 X2", "(old) G1 X3", False),
        ("proof.json", '{"told": ["at 3 mm", 2.5]}', '{"stated": ["3 mm away", 2.5]}', True),
        ("proof.json", '{"told": ["at 3 mm", 2.5]}', '{"told": ["at 4 mm", 2.5]}', False),
        ("proof.json", '{"told": [[1], 2]}', '{"told": [1, [2]]}', False),
        ("proof.json", '{"sha": "00ab34cd12"}', '{"sha": "00ab34cd13"}', True),
        ("report.html", "<p>2 mm off, limit 3 mm</p>", "<p>limit 3 mm, deviation 2 mm</p>", True),
        ("report.html", "<p>2 mm</p>", "<p>2.5 mm</p>", False),
        ("report.html", "<p>0.5mm</p>", "<p>0.7mm</p>", False),
        ("report.html", "<p>at -2 mm</p>", "<p>at 2 mm</p>", False),
        ("report.html", '<path d="M10.5L20"/>', '<path d="M10.5L21"/>', False),
    ],
)
def test_words_alone_do_not_change_a_wordless_digest(name: str, old: str, new: str, same: bool) -> None:
    assert (wordless.digest(name, old.encode()) == wordless.digest(name, new.encode())) is same
