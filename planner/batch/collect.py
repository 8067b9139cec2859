"""What a batch is asked to plan: files, folders, bundled names, batch files, as items in a fixed order."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from planner import pipeline, yaml_lines
from planner.batch.batch_file import BATCH, read_batch
from planner.batch.job import PROBLEM, safe_names
from planner.catalogue import bundled
from planner.files import STAGING, is_file
from planner.issues import Issue, TandemError
from planner.problem import Problem

SUFFIXES = (".yaml", ".yml")


@dataclasses.dataclass(frozen=True)
class Item:
    """One problem of a batch: its ``name`` among the results, where it comes from, how to read it (raises
    ``TandemError``), and the values that a batch file gave it."""

    name: str
    origin: str
    read: Callable[[], Problem]
    varied: Mapping[str, object] = dataclasses.field(default_factory=dict)


def collect(given: Sequence[Path], leave_out: Path) -> list[Item]:
    """Items of all that is given; what lies in ``leave_out``, where results go, is none.

    A folder stands for every problem file beneath it, and for every YAML file that cannot be read. Raises
    ``TandemError`` with all faults found: nothing
    there (``problem.missing_file``), or a batch file's own.
    """
    found: list[Item] = []
    issues: list[Issue] = []
    for path in given:
        try:
            found += _items(path, leave_out.resolve())
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    names = safe_names(item.name for item in found)
    return [dataclasses.replace(item, name=name) for item, name in zip(found, names, strict=True)]


def _items(path: Path, leave_out: Path) -> list[Item]:
    if path.is_dir():
        files = [file for file in _files(path) if not file.resolve().is_relative_to(leave_out)]
        items = [item for file in files for item in _in_file(file, path) if _kind(file) is not None]
        if not items:
            what = f"{path}: no problem file in this folder; a problem file is YAML with 'tandem: 1'"
            raise TandemError(Issue("problem.missing_file", what, file=str(path)))
        return items
    for file in (path, bundled(path), bundled(path / PROBLEM)):
        if is_file(file):
            return _in_file(file, file.parent.parent if file.name == PROBLEM else file.parent)
    what = f"{path}: no such file, folder or bundled problem; check the name"
    raise TandemError(Issue("problem.missing_file", what, file=str(path)))


def _files(folder: Path) -> Iterator[Path]:
    """YAML files beneath a folder, by name, hidden ones and unfinished results left out."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith((".", STAGING)):
            continue
        if path.is_dir() and not path.is_symlink():
            yield from _files(path)
        elif path.suffix.lower() in SUFFIXES and path.is_file() and _kind(path) is not None:
            yield path


def _kind(path: Path) -> str | None:
    """``tandem`` for a problem file, ``batch`` for a batch file, by a top-level key; None for others.

    What cannot be read counts as a problem file: nobody can say that it is none, and its row says what is
    wrong with it.
    """
    try:
        data = yaml_lines.read(path).data
    except TandemError:
        return "tandem"
    return next((key for key in (BATCH, "tandem") if key in data), None)


def _in_file(path: Path, root: Path) -> list[Item]:
    name = _name(path, root)
    if _kind(path) == BATCH:
        return [Item(f"{name}-{v.name}", f"{path} {v.name}", v.read, v.values) for v in read_batch(path)]
    return [Item(name, str(path), lambda: pipeline.load(path))]


def _name(path: Path, root: Path) -> str:
    """``wing/problem.yaml`` is ``wing``, ``wing/small.yaml`` is ``wing-small`` seen from above ``wing``."""
    try:
        steps = list(path.relative_to(root).with_suffix("").parts)
    except ValueError:
        steps = [path.stem]
    if steps[-1] == Path(PROBLEM).stem:
        steps = steps[:-1] or [path.resolve().parent.name]
    return "-".join(steps)
