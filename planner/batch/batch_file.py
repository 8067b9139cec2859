"""A batch file: one problem, and the fields of it that vary from job to job.

Fields are named by dotted paths: ``settings.clearance_mm``, ``operations.0.feed_mm_s``,
``cell.arms.left.tool.radius_mm``; an entry of a list by its number or its name.
"""

import csv
import dataclasses
import io
import itertools
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from planner import pipeline
from planner.batch.job import PROBLEM
from planner.catalogue.robots import bundled
from planner.files import is_file
from planner.issues import Issue, TandemError, refusal
from planner.problem import Problem
from planner.reading import problem as problem_file
from planner.reading import strict_yaml
from planner.reading.strict_yaml import Document, FileName, changed_field

BATCH: Final = "batch"
"""The key that every batch file begins with."""
MAX_JOBS: Final = 100_000
"""Jobs that one batch file may make, and values that one range may have."""
MAX_CSV_BYTES = 20_000_000
"""Bytes that a table of varied values may have."""

Plain = str | float | int | bool | None
Value = Plain | list[Any] | dict[str, Any]


class RangeFile(BaseModel):
    """Numbers evenly spaced from ``from`` to ``to``, both included: so many (``count``) or every ``step``."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    start: Annotated[float, Field(alias="from", description="first value")]
    to: Annotated[float, Field(description="last value, or beyond it where a step does not divide the range")]
    count: Annotated[int | None, Field(ge=2, le=MAX_JOBS, description="so many values, or")] = None
    step: Annotated[float | None, Field(gt=0, description="one every so much; give one of the two")] = None

    @model_validator(mode="after")
    def _one_spacing(self) -> Self:
        if (self.count is None) == (self.step is None):
            raise ValueError("a range has a count or a step, one of them")
        if self.step is not None and abs(self.to - self.start) / self.step > MAX_JOBS:
            raise ValueError(f"a range of over {MAX_JOBS} values; make the step larger")
        return self

    def values(self) -> list[float]:
        """The numbers; a step that does not divide the range stops short of its end."""
        if self.count is not None:
            share = (self.to - self.start) / (self.count - 1)
            return [_plain(self.start + i * share) for i in range(self.count - 1)] + [_plain(self.to)]
        step = (self.step or 1.0) * (1.0 if self.to >= self.start else -1.0)
        steps = int((self.to - self.start) / step * (1.0 + 1e-12) + 1e-9)
        return [_plain(self.start + i * step) for i in range(steps + 1)]


class BatchFile(BaseModel):
    """A whole batch file, version 1. ``vary``: values of fields, each a list or a range, by the field's
    dotted path in the problem; ``combine`` them all with each other, or the first ones, the second ones, ...
    ``csv``: a table with a heading of paths, one job a line; each is combined with what ``vary`` says.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    batch: Annotated[Literal[1], Field(description="version of this format")]
    problem: Annotated[FileName, Field(description="problem file or bundled problem")]
    vary: Annotated[
        dict[str, Annotated[list[Value], Field(min_length=1)] | RangeFile],
        Field(description="values by path: each a list, or a range (see below)"),
    ] = {}
    combine: Annotated[
        Literal["product", "zip"],
        Field(description="all values with each other, or the first of each, the second of each, ..."),
    ] = "product"
    csv: Annotated[FileName | None, Field(description="table of problems; a column name names them")] = None

    @model_validator(mode="after")
    def _something_varies(self) -> Self:
        if not self.vary and self.csv is None:
            raise ValueError("nothing varies: give vary or csv, or plan the problem itself")
        counts = {path: len(self.listed(path)) for path in self.vary}
        if self.combine == "zip" and len(set(counts.values())) > 1:
            found = ", ".join(f"{path} has {count}" for path, count in counts.items())
            raise ValueError(f"combine: zip takes as many values of each field; {found}")
        return self

    def listed(self, path: str) -> list[Any]:
        """The values of one varied field."""
        values = self.vary[path]
        return values.values() if isinstance(values, RangeFile) else list(values)

    def rows(self) -> list[dict[str, Any]]:
        """Values by path, of each combination that ``vary`` asks for."""
        columns = [self.listed(path) for path in self.vary]
        mixed = zip(*columns, strict=True) if self.combine == "zip" else itertools.product(*columns)
        return [dict(zip(self.vary, row, strict=True)) for row in mixed] if columns else [{}]


@dataclasses.dataclass(frozen=True)
class Variant:
    """One job of a batch file: its ``name``, the ``values`` of its varied fields by path."""

    name: str
    values: Mapping[str, Any]
    base: Document
    document: Document

    def read(self) -> Problem:
        """The problem with the values in it; raises ``TandemError`` with every fault, each named by the batch
        file's line where a varied field is at fault, else by the problem file's."""
        source = problem_file.resolved(self.base.data, self.base.path.parent.resolve())
        issues = []
        for path, value in self.values.items():
            try:
                changed_field(source, path, value, self.document.path.parent)
            except ValueError as error:
                issues.append(self._issue(path, str(error)))
        if issues:
            raise TandemError(issues)
        with tempfile.TemporaryDirectory(prefix="tandem-") as folder:
            file = Path(folder) / PROBLEM
            file.write_text(yaml.safe_dump(source, sort_keys=False, allow_unicode=True))
            try:
                problem: Problem = pipeline.load(file)
            except TandemError as error:
                raise TandemError([self._placed(issue, file) for issue in error.issues]) from error
        return dataclasses.replace(problem, path=self.base.path)

    def _issue(self, path: str, what: str) -> Issue:
        place = self.document.line(("vary", path)) if path in self.document.data.get("vary", {}) else None
        file = str(self.document.path)
        return Issue("batch.field", f"{self.name}: {path}: {what}", file=file, line=place, field=path)

    def _placed(self, issue: Issue, file: Path) -> Issue:
        if issue.file != str(file):
            return issue
        field = issue.field or ""
        varied = next((p for p in self.values if field == p or field.startswith(f"{p}.")), None)
        if varied is None:
            steps = tuple(int(s) if s.isdigit() else s for s in field.split("."))
            return dataclasses.replace(issue, file=str(self.base.path), line=self.base.line(steps))
        line = self.document.line(("vary", varied))
        message = f"{self.name}: {issue.message}"
        return dataclasses.replace(issue, file=str(self.document.path), line=line, message=message)


def read_batch(path: Path) -> list[Variant]:
    """The jobs of a batch file, in order; raises ``TandemError`` with every fault and its line
    (``batch.field``, ``batch.csv``, and those of a file that is no YAML)."""
    document = strict_yaml.read(path)
    try:
        spec = BatchFile.model_validate(document.data, strict=False)
    except ValidationError as error:
        raise TandemError([_fault(dict(e), document) for e in error.errors()]) from error
    issues: list[Issue] = []
    base: Document | None = None
    table: list[dict[str, Any]] = [{}]
    try:
        base = _base(spec, document)
    except TandemError as error:
        issues += error.issues
    try:
        table = _table(path.parent / spec.csv, document) if spec.csv is not None else table
    except TandemError as error:
        issues += error.issues
    if base is None or issues:
        raise TandemError(issues)
    rows = [(line, row) for line in table for row in spec.rows()]
    if len(rows) > MAX_JOBS:
        what = f"vary: {len(rows)} jobs, at most {MAX_JOBS} are taken; vary less, or in several batch files"
        raise refusal("batch.field", what, file=str(path), line=document.line(("vary",)))
    width = max(3, len(str(len(rows))))
    out = []
    for number, (line, row) in enumerate(rows, 1):
        values = {k: v for k, v in line.items() if k != "name"} | row
        named = str(line.get("name") or "")
        single = named and len(spec.rows()) == 1
        name = named if single else f"{named}-{number:0{width}d}" if named else f"{number:0{width}d}"
        out.append(Variant(name, values, base, document))
    return out


def _base(spec: BatchFile, document: Document) -> Document:
    given = Path(spec.problem)
    beside = document.path.parent / given
    for file in (beside, beside / PROBLEM, bundled(given), bundled(given / PROBLEM)):
        if is_file(file):
            return strict_yaml.read(file)
    what = f"problem: no file {beside} and no bundled problem of that name; check the path"
    line = document.line(("problem",))
    raise refusal("batch.field", what, file=str(document.path), line=line, field="problem")


def _table(path: Path, document: Document) -> list[dict[str, Any]]:
    """Rows of a CSV file, values read as YAML reads them, empty cells left out."""
    try:
        if path.stat().st_size > MAX_CSV_BYTES:
            raise _bad_table(path, f"is over {MAX_CSV_BYTES // 1_000_000} MB; split it", document)
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise _bad_table(path, f"cannot be read ({error}); check the path", document) from error
    lines = list(csv.reader(io.StringIO(text)))
    heads = [head.strip() for head in lines[0]] if lines else []
    if not heads or any(not head for head in heads) or len(set(heads)) < len(heads):
        what = "has no heading; write one path in each column of its first line, none twice"
        raise _bad_table(path, what, document)
    issues = []
    rows = []
    for number, cells in enumerate(lines[1:], 2):
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(heads):
            what = f"{path}: {len(cells)} cells, but the heading has {len(heads)}; give one for each"
            issues.append(Issue("batch.csv", what, file=str(path), line=number))
            continue
        pairs = zip(heads, cells, strict=True)
        rows.append({head: _scalar(cell) for head, cell in pairs if cell.strip()})
    if issues:
        raise TandemError(issues)
    if not rows:
        raise _bad_table(path, "has no lines below its heading; give a line for each job", document)
    return rows


def _bad_table(path: Path, what: str, document: Document) -> TandemError:
    line = document.line(("csv",))
    return refusal("batch.csv", f"{path} {what}", file=str(document.path), line=line, field="csv")


def _scalar(cell: str) -> Any:
    """A cell as YAML reads it, where that is plain; else its text."""
    try:
        value = yaml.safe_load(cell)
    except yaml.YAMLError:
        return cell.strip()
    return value if isinstance(value, str | int | float | bool | list) else cell.strip()


def _plain(value: float) -> float:
    """A number without the noise of its sum, and whole where it is: fields that count take no 3.0."""
    tidy = float(f"{value:.12g}")
    return int(tidy) if tidy.is_integer() and abs(tidy) < 1e15 else tidy


def _fault(error: Mapping[str, Any], document: Document) -> Issue:
    location = tuple(s for s in error["loc"] if s not in ("RangeFile",) and not str(s).startswith("list["))
    field = ".".join(str(step) for step in location)
    what = "unknown key; remove it or correct its spelling"
    if error["type"] != "extra_forbidden":
        what = f"{error['msg']}; " + ("add it" if error["type"] == "missing" else "correct it")
    text = f"{field}: {what}" if field else what
    return Issue(
        "batch.field", text, file=str(document.path), line=document.line(location), field=field or None
    )
