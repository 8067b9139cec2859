"""A batch file: one problem, and the fields of it that vary from job to job.

Fields are named by dotted paths: ``settings.clearance_mm``, ``operations.0.feed_mm_s``,
``cell.arms.left.tool.radius_mm``. An entry of a list is named by its number or its name.
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
from planner.batch.job import PROBLEM_FILE
from planner.catalogue.robots import bundled_path
from planner.files import is_file
from planner.issues import Issue, TandemError, issue_error
from planner.problem import Problem
from planner.reading import problem as problem_file
from planner.reading import strict_yaml
from planner.reading.strict_yaml import Document, FileName, set_field

BATCH_KEY: Final = "batch"
"""Key that every batch file starts with."""
MAX_JOBS: Final = 100_000
"""Maximum number of jobs of a batch file, and of values of a range."""
MAX_CSV_BYTES = 20_000_000
"""Maximum size of a table of varied values [bytes]."""

PlainValue = str | float | int | bool | None
FieldValue = PlainValue | list[Any] | dict[str, Any]


class RangeFile(BaseModel):
    """Numbers evenly spaced from ``from`` to ``to``, both included.

    There are ``count`` of them, or one every ``step``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    start: Annotated[float, Field(alias="from", description="first value")]
    to: Annotated[float, Field(description="last value, or beyond it if the step does not divide the range")]
    count: Annotated[int | None, Field(ge=2, le=MAX_JOBS, description="number of values")] = None
    step: Annotated[float | None, Field(gt=0, description="spacing; give either count or step")] = None

    @model_validator(mode="after")
    def _one_spacing(self) -> Self:
        if (self.count is None) == (self.step is None):
            raise ValueError("a range has either a count or a step")
        if self.step is not None and abs(self.to - self.start) / self.step > MAX_JOBS:
            raise ValueError(f"a range of more than {MAX_JOBS} values; use a larger step")
        return self

    def values(self) -> list[float]:
        """Return the numbers. A step that does not divide the range stops short of its end."""
        if self.count is not None:
            step_size = (self.to - self.start) / (self.count - 1)
            return [_tidy_number(self.start + i * step_size) for i in range(self.count - 1)] + [
                _tidy_number(self.to)
            ]
        step = (self.step or 1.0) * (1.0 if self.to >= self.start else -1.0)
        # The tolerances keep the last value if rounding makes the quotient slightly too small.
        step_count = int((self.to - self.start) / step * (1.0 + 1e-12) + 1e-9)
        return [_tidy_number(self.start + i * step) for i in range(step_count + 1)]


class BatchFile(BaseModel):
    """A whole batch file, version 1.

    ``vary``: values of fields, each a list or a range, by the field's dotted path in the problem. ``combine``
    takes all combinations, or the first ones, the second ones, and so on. ``csv``: a table with a heading of
    paths, one job per line; each line is combined with the values of ``vary``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    batch: Annotated[Literal[1], Field(description="version of this format")]
    problem: Annotated[FileName, Field(description="problem file or bundled problem")]
    vary: Annotated[
        dict[str, Annotated[list[FieldValue], Field(min_length=1)] | RangeFile],
        Field(description="values by path: each a list, or a range (see below)"),
    ] = {}
    combine: Annotated[
        Literal["product", "zip"],
        Field(description="all combinations of values, or the first of each, the second of each, ..."),
    ] = "product"
    csv: Annotated[FileName | None, Field(description="table of problems; a column name names them")] = None

    @model_validator(mode="after")
    def _something_varies(self) -> Self:
        if not self.vary and self.csv is None:
            raise ValueError("nothing varies; give vary or csv, or plan the problem itself")
        counts = {path: len(self.values_of(path)) for path in self.vary}
        if self.combine == "zip" and len(set(counts.values())) > 1:
            counts_text = ", ".join(f"{path} has {count}" for path, count in counts.items())
            raise ValueError(f"combine: zip needs the same number of values for each field; {counts_text}")
        return self

    def values_of(self, path: str) -> list[Any]:
        """Return the values of one varied field."""
        values = self.vary[path]
        return values.values() if isinstance(values, RangeFile) else list(values)

    def rows(self) -> list[dict[str, Any]]:
        """Return the values by path, one dictionary for each combination of ``vary``."""
        columns = [self.values_of(path) for path in self.vary]
        combinations = zip(*columns, strict=True) if self.combine == "zip" else itertools.product(*columns)
        return [dict(zip(self.vary, row, strict=True)) for row in combinations] if columns else [{}]


@dataclasses.dataclass(frozen=True)
class BatchVariant:
    """One job of a batch file.

    Attributes:
        name: Name of the job.
        values: Values of its varied fields by path.
        base: The problem file.
        document: The batch file.
    """

    name: str
    values: Mapping[str, Any]
    base: Document
    document: Document

    def read(self) -> Problem:
        """Return the problem with the values in it.

        Raises:
            TandemError: Every error, with the batch file's line if a varied field is at fault, else the
                problem file's.
        """
        source = problem_file.resolve_files(self.base.data, self.base.path.parent.resolve())
        issues = []
        for path, value in self.values.items():
            try:
                set_field(source, path, value, self.document.path.parent)
            except ValueError as error:
                issues.append(self._field_issue(path, str(error)))
        if issues:
            raise TandemError(issues)
        with tempfile.TemporaryDirectory(prefix="tandem-") as folder:
            file = Path(folder) / PROBLEM_FILE
            file.write_text(yaml.safe_dump(source, sort_keys=False, allow_unicode=True))
            try:
                problem: Problem = pipeline.load(file)
            except TandemError as error:
                raise TandemError([self._relocated(issue, file) for issue in error.issues]) from error
        return dataclasses.replace(problem, path=self.base.path)

    def _field_issue(self, path: str, problem: str) -> Issue:
        line = self.document.line(("vary", path)) if path in self.document.data.get("vary", {}) else None
        file = str(self.document.path)
        return Issue("batch.field", f"{self.name}: {path}: {problem}", file=file, line=line, field=path)

    def _relocated(self, issue: Issue, file: Path) -> Issue:
        """Return an issue of the temporary problem file ``file`` with the line that the user can correct.

        This is the line of the batch file for a varied field, else the line of the problem file.
        """
        if issue.file != str(file):
            return issue
        field = issue.field or ""
        varied_field = next(
            (
                varied_path
                for varied_path in self.values
                if field == varied_path or field.startswith(f"{varied_path}.")
            ),
            None,
        )
        if varied_field is None:
            location = tuple(int(part) if part.isdigit() else part for part in field.split("."))
            return dataclasses.replace(issue, file=str(self.base.path), line=self.base.line(location))
        line = self.document.line(("vary", varied_field))
        message = f"{self.name}: {issue.message}"
        return dataclasses.replace(issue, file=str(self.document.path), line=line, message=message)


def read_batch(path: Path) -> list[BatchVariant]:
    """Return the jobs of a batch file, in order.

    Raises:
        TandemError: Every error with its line (``batch.field``, ``batch.csv``, and those of invalid YAML).
    """
    document = strict_yaml.read(path)
    try:
        batch_file = BatchFile.model_validate(document.data, strict=False)
    except ValidationError as error:
        raise TandemError(
            [_validation_issue(dict(error_details), document) for error_details in error.errors()]
        ) from error
    issues: list[Issue] = []
    base: Document | None = None
    table: list[dict[str, Any]] = [{}]
    try:
        base = _base_document(batch_file, document)
    except TandemError as error:
        issues += error.issues
    try:
        table = _read_table(path.parent / batch_file.csv, document) if batch_file.csv is not None else table
    except TandemError as error:
        issues += error.issues
    if base is None or issues:
        raise TandemError(issues)
    jobs = [(table_row, varied_values) for table_row in table for varied_values in batch_file.rows()]
    if len(jobs) > MAX_JOBS:
        message = f"vary: got {len(jobs)} jobs, allowed {MAX_JOBS}; vary less, or use several batch files"
        raise issue_error("batch.field", message, file=str(path), line=document.line(("vary",)))
    digits = max(3, len(str(len(jobs))))
    variants = []
    for number, (table_row, varied_values) in enumerate(jobs, 1):
        values = {field: value for field, value in table_row.items() if field != "name"} | varied_values
        row_name = str(table_row.get("name") or "")
        is_name_unique = row_name and len(batch_file.rows()) == 1
        name = (
            row_name
            if is_name_unique
            else f"{row_name}-{number:0{digits}d}"
            if row_name
            else f"{number:0{digits}d}"
        )
        variants.append(BatchVariant(name, values, base, document))
    return variants


def _base_document(spec: BatchFile, document: Document) -> Document:
    """Read the problem file of a batch: a file next to the batch file, else a bundled problem."""
    stated_path = Path(spec.problem)
    relative_file = document.path.parent / stated_path
    for file in (
        relative_file,
        relative_file / PROBLEM_FILE,
        bundled_path(stated_path),
        bundled_path(stated_path / PROBLEM_FILE),
    ):
        if is_file(file):
            return strict_yaml.read(file)
    message = f"problem: no file {relative_file} and no bundled problem of that name; check the path"
    line = document.line(("problem",))
    raise issue_error("batch.field", message, file=str(document.path), line=line, field="problem")


def _read_table(path: Path, document: Document) -> list[dict[str, Any]]:
    """Return the rows of the CSV file of a batch, each as values by the field path in the heading.

    Each row becomes one or more jobs. Values are read as YAML. Empty cells and empty lines are left out.
    ``document`` is the batch file, for the line of issues.

    Raises:
        TandemError: ``batch.csv``.
    """
    try:
        if path.stat().st_size > MAX_CSV_BYTES:
            raise _table_error(path, f"is larger than {MAX_CSV_BYTES // 1_000_000} MB; split it", document)
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise _table_error(path, f"cannot be read ({error}); check the path", document) from error
    csv_rows = list(csv.reader(io.StringIO(text)))
    paths = [path_name.strip() for path_name in csv_rows[0]] if csv_rows else []
    if not paths or any(not path_name for path_name in paths) or len(set(paths)) < len(paths):
        message = "has no valid heading; write one path in each column of its first line, none twice"
        raise _table_error(path, message, document)
    issues = []
    rows = []
    for number, cells in enumerate(csv_rows[1:], 2):
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(paths):
            message = f"{path}: {len(cells)} cells, but the heading has {len(paths)}; give one for each"
            issues.append(Issue("batch.csv", message, file=str(path), line=number))
            continue
        pairs = zip(paths, cells, strict=True)
        rows.append({path_name: _parse_cell(cell) for path_name, cell in pairs if cell.strip()})
    if issues:
        raise TandemError(issues)
    if not rows:
        raise _table_error(path, "has no lines below its heading; add a line for each job", document)
    return rows


def _table_error(path: Path, problem: str, document: Document) -> TandemError:
    line = document.line(("csv",))
    return issue_error("batch.csv", f"{path} {problem}", file=str(document.path), line=line, field="csv")


def _parse_cell(cell: str) -> Any:
    """Return a cell as YAML reads it if that is plain data, else its text."""
    try:
        value = yaml.safe_load(cell)
    except yaml.YAMLError:
        return cell.strip()
    return value if isinstance(value, str | int | float | bool | list) else cell.strip()


def _tidy_number(value: float) -> float:
    """Return a number without rounding noise, and as an integer if possible: count fields accept no 3.0."""
    rounded = float(f"{value:.12g}")
    return int(rounded) if rounded.is_integer() and abs(rounded) < 1e15 else rounded


def _validation_issue(error: Mapping[str, Any], document: Document) -> Issue:
    """Convert an error of pydantic to an issue with the line in the batch file."""
    # Pydantic adds the alternatives of a union to the location. They are not keys of the file.
    location = tuple(
        step for step in error["loc"] if step not in ("RangeFile",) and not str(step).startswith("list[")
    )
    field = ".".join(str(step) for step in location)
    message = "unknown key; remove it or correct its spelling"
    if error["type"] != "extra_forbidden":
        message = f"{error['msg']}; " + ("add it" if error["type"] == "missing" else "correct it")
    text = f"{field}: {message}" if field else message
    return Issue(
        "batch.field", text, file=str(document.path), line=document.line(location), field=field or None
    )
