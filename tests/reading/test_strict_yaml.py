"""YAML files with the line of every field. A file that is no problem file is refused with its line."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from planner.issues import TandemError
from planner.reading import strict_yaml


def expect_refusal(path: Path) -> tuple[str, int | None]:
    with pytest.raises(TandemError) as caught:
        strict_yaml.read(path)
    (issue,) = caught.value.issues
    return issue.code, issue.line


def test_lines_of_fields(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text("tandem: 1\nstock:\n  size_mm: [1, 2, 3]\noperations:\n  - name: a\n    process: b\n")
    document = strict_yaml.read(path)
    assert document.line(("stock", "size_mm")) == 3
    assert document.line(("operations", 0, "process")) == 6
    assert document.line(("operations", 0, "missing")) == 5
    assert document.line(("nothing",)) == 1


def test_a_float_without_a_point_is_a_number(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text("a: 1e-3\nb: 2E3\n")
    assert strict_yaml.read(path).data == {"a": 1e-3, "b": 2000.0}


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("a: [1, 2\nb: 3\n", "problem.not_yaml", 2),
        ("- 1\n- 2\n", "problem.not_yaml", 1),
        ("", "problem.not_yaml", 1),
        ("just words\n", "problem.not_yaml", 1),
        ("a: 1\nb: {c: 1,\n  c: 2}\n", "problem.duplicate_name", 3),
        ("a: !!python/object/apply:os.system ['true']\n", "problem.not_yaml", 1),
    ],
)
def test_what_is_not_a_problem_file_is_refused_with_its_line(
    tmp_path: Path, text: str, code: str, line: int
) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(text)
    assert expect_refusal(path) == (code, line)


def test_missing_binary_and_huge_files_are_refused(tmp_path: Path) -> None:
    assert expect_refusal(tmp_path / "no.yaml")[0] == "problem.missing_file"
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe\x00\x01")
    assert expect_refusal(tmp_path / "b.yaml")[0] == "problem.not_yaml"
    with (tmp_path / "h.yaml").open("wb") as stream:
        stream.truncate(100_000_001)
    assert expect_refusal(tmp_path / "h.yaml")[0] == "problem.too_large"


@pytest.mark.parametrize(
    ("text", "expected_text"),
    [("a: [" + "1, " * 1_000_001 + "1]", "values"), ("a: " + "[" * 100_000, "deep")],
)
def test_values_and_depth_are_counted_before_anything_is_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, expected_text: str
) -> None:
    def build(*_: object, **__: object) -> None:
        pytest.fail("it was built")

    monkeypatch.setattr(yaml, "compose", build)
    (tmp_path / "large.yaml").write_text(text)
    with pytest.raises(TandemError, match=expected_text):
        strict_yaml.read(tmp_path / "large.yaml")
