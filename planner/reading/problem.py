"""Reads a problem file: parse, validate every field, collect all faults, convert to SI units.

Operations belong to processes, so the caller passes their schemas; this module knows none. Problems
can be carried: file names are made absolute, files packed, or counted in a digest.
"""

import dataclasses
import hashlib
import json
import re
import reprlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, BaseModel, Field, Tag, ValidationError, model_validator

from planner.catalogue.robots import bundled
from planner.files import carried_name, each_file, is_file
from planner.geometry.units import DEG, MM
from planner.issue_codes import all_codes
from planner.issues import Issue, TandemError, refusal
from planner.problem import Cell, Change, Fixed, Force, Operation, Problem, Settings
from planner.reading import axes, controller, grip_choice, loads, materials, rails, strict_yaml
from planner.reading import cell as cell_file
from planner.reading import part as part_file
from planner.reading import sheet as sheet_file
from planner.reading import stock as stock_file
from planner.reading.cell import CellFile
from planner.reading.loads import ForcesFile
from planner.reading.part import PartFile
from planner.reading.robot_file import with_meshes
from planner.reading.sheet import SheetFile
from planner.reading.stock import SetupFile, StockFile
from planner.reading.strict_yaml import Choice, Document, Name, Strict


def find(path: Path) -> Path:
    """The problem file, or the one in the folder of that name; bundled ones are known by their names."""
    for candidate in (path, path / "problem.yaml", bundled(path), bundled(path / "problem.yaml")):
        if is_file(candidate):
            return candidate
    return path


def bundle(problem: Problem) -> dict[str, bytes]:
    """The problem as files that stand alone, as :func:`packed`."""
    return packed(problem.source)


def packed(source: Mapping[str, Any]) -> dict[str, bytes]:
    """A problem's values, as :func:`resolved` gives them, as files that stand alone: ``problem.yaml`` with
    the cell inside, and what it names in ``files/``,
    by the user's names with hashes.

    Reading them gives a problem with the same digest, so a result folder can be proven wherever it is
    carried. Raises ``OSError`` for a file that is not there.
    """
    files: dict[str, bytes] = {}

    def carry(path: Path) -> str:
        content = path.read_bytes()
        name = f"files/{carried_name(path.name, hashlib.sha256(content).hexdigest())}"
        files[name] = content
        return name

    text = strict_yaml.dump(each_file(source, carry))
    return {"problem.yaml": text.encode(), **files}


def resolved(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The file's data with its cell inside and every file name made absolute."""
    out: dict[str, Any] = each_file(data, lambda path: str(folder / path))
    beside = folder
    if isinstance(data.get("cell"), str):
        path = folder / data["cell"]
        beside = path.parent
        out["cell"] = each_file(strict_yaml.read(path).data, lambda name: str(path.parent / name))
    cell = out.get("cell")
    arms = cell.get("arms") if isinstance(cell, dict) else None
    for arm in arms if isinstance(arms, list) else ():
        if isinstance(arm, dict) and isinstance(arm.get("robot"), dict):
            arm["robot"] = with_meshes(arm["robot"], beside)
    return out


def digest(source: Mapping[str, Any]) -> str:
    """SHA-256 over the problem's values and the contents of its files: where they lie and comments do not
    matter, nor what is only seen of a robot.
    """

    def content(path: Path) -> str:
        return hashlib.sha256(path.read_bytes()).hexdigest() if is_file(path) else "missing"

    text = json.dumps(each_file(_unseen(source), content), sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _unseen(source: Mapping[str, Any]) -> dict[str, Any]:
    """A problem's values without visual meshes: a result stays what it is where they are found, or not."""
    out = dict(source)
    cell = out.get("cell")
    if isinstance(cell, Mapping) and isinstance(cell.get("arms"), list):
        out["cell"] = {**cell, "arms": [_unseen_arm(arm) for arm in cell["arms"]]}
    return out


def _unseen_arm(arm: Any) -> Any:
    robot = arm.get("robot") if isinstance(arm, Mapping) else None
    if not isinstance(robot, Mapping):
        return arm
    return {**arm, "robot": {key: value for key, value in robot.items() if key != "visuals"}}


OperationModels = Mapping[str, type[BaseModel] | Issue]


class SettingsFile(Strict):
    """Limits that planning and proof share. ``clearance_mm`` holds between all bodies: arms, tools, block,
    obstacles, wires. ``own_clearance_mm`` takes its place between base, links and tool of one arm, and is at
    most as much; not for its wire, cutter or forming head, nor for a block that it holds. Unless stated it is
    5, or ``clearance_mm`` where that is less."""

    clearance_mm: float = Field(default=Settings.clearance / MM, ge=0, le=500)
    own_clearance_mm: Annotated[float, Field(ge=0, le=500)] | None = None
    speed_fraction: float = Field(default=Settings.speed_fraction, ge=0.01, le=1)
    acceleration_fraction: float = Field(default=Settings.acceleration_fraction, ge=0.01, le=1)
    joint_margin_deg: float = Field(default=Settings.joint_margin / DEG, ge=0, le=45)
    singularity_margin_deg: float = Field(default=Settings.singularity_margin / DEG, ge=0, le=45)
    tcp_speed_mm_s: float = Field(default=Settings.tcp_speed / MM, ge=1, le=5000)
    seed: int = Field(default=Settings.seed, ge=0, lt=2**31)

    @model_validator(mode="after")
    def _own_is_less(self) -> "SettingsFile":
        if self.own_clearance_mm is not None and self.own_clearance_mm > self.clearance_mm:
            raise ValueError(
                f"own_clearance_mm is {self.own_clearance_mm:g}, allowed is at most clearance_mm, here "
                f"{self.clearance_mm:g}: lower it, or widen clearance_mm, which holds for all bodies"
            )
        return self

    def build(self) -> Settings:
        """The settings in SI units."""
        return Settings(
            clearance=self.clearance_mm * MM,
            own_clearance=None if self.own_clearance_mm is None else self.own_clearance_mm * MM,
            speed_fraction=self.speed_fraction,
            acceleration_fraction=self.acceleration_fraction,
            joint_margin=self.joint_margin_deg * DEG,
            singularity_margin=self.singularity_margin_deg * DEG,
            tcp_speed=self.tcp_speed_mm_s * MM,
            seed=self.seed,
        )


def _acceptable(code: str) -> str:
    acceptable = sorted(name for name, row in all_codes().items() if row.accepts)
    if code not in acceptable:
        raise ValueError(f"this cannot be accepted; what can be is {', '.join(acceptable)}")
    return code


class ProblemFile(Strict):
    """A whole problem file, schema version 1. Each operation is checked against its process's own schema."""

    tandem: Literal[1]
    name: Name
    cell: Annotated[
        Annotated[str, Tag("word"), Field(max_length=1000)] | Annotated[CellFile, Tag("mapping")], Choice
    ]
    stock: StockFile | None = None
    sheet: SheetFile | None = Field(default=None, description="a clamped sheet to form, in place of a block")
    part: PartFile | None = None
    settings: SettingsFile = SettingsFile()
    accept: tuple[Annotated[str, Field(max_length=60), AfterValidator(_acceptable)], ...] = Field(
        default=(), max_length=20, description="codes of errors that are known and wanted, see below"
    )
    operations: list[dict[str, Any]] = Field(min_length=1)

    @model_validator(mode="after")
    def _one_stock(self) -> Self:
        if (self.stock is None) == (self.sheet is None):
            raise ValueError(
                "stock: give the block as stock, or the sheet to be formed as sheet, one of them"
            )
        return self


def read(path: Path, models: OperationModels) -> Problem:
    """Read, validate and convert the problem file at ``path``; ``models`` maps a process to its operation's
    schema.

    Raises ``TandemError`` with every fault that was found, each with its field and, where the format gives
    it, its line.
    """
    return build(strict_yaml.read(path), models)


def build(document: Document, models: OperationModels) -> Problem:
    """The problem of a file that is parsed; else as :func:`read`."""
    path = document.path
    spec, issues = validate(ProblemFile, document.data, document, ())
    raw_operations = document.data.get("operations")
    operations: list[Operation] = []
    setups: dict[int, SetupFile] = {}
    forces: dict[int, dict[str, Force]] = {}
    if isinstance(raw_operations, list):
        for index, raw in enumerate(raw_operations):
            setup, faults = read_setup(raw, index, document)
            issues += faults
            if setup is not None:
                setups[index] = setup
            stated, faults = read_forces(raw, index, document)
            issues += faults
            if stated:
                forces[index] = stated
            operation, faults = read_operation(raw, index, document, models)
            issues += faults
            if operation is not None:
                operations.append(operation)
    cell = None
    if spec is not None:
        try:
            cell = _cell(spec.cell, document)
        except TandemError as error:
            issues += error.issues
    if cell is not None and spec is not None and spec.stock is not None:
        try:
            cell = stock_file.with_gripper(cell, spec.stock)
        except TandemError as error:
            issues += [_placed(issue, document) for issue in error.issues]
    if cell is not None:
        issues += _names(cell, operations, document)
        issues += [_placed(issue, document) for issue in controller.faults(cell, operations)]
        issues += [_placed(issue, document) for issue in materials.wire_faults(cell.wires, operations)]
    part, stock = None, None
    changes: dict[int, Change] = {}
    if spec is not None:
        try:
            if spec.sheet is not None:
                stock = sheet_file.stock(spec.sheet)
            elif spec.stock is not None:
                stock = stock_file.stock(spec.stock, path.parent)
        except TandemError as error:
            issues += [_placed(issue, document) for issue in error.issues]
            issues += _part_faults(document)
    else:
        issues += _part_faults(document)
    if cell is not None:
        changes, faults = _changes(setups, cell, path.parent, document)
        issues += faults
    if spec is not None and spec.part is not None and stock is not None:
        try:
            part = part_file.build(spec.part, path.parent, stock)
            stock = sheet_file.with_formed(stock, part)
            for k, operation in enumerate(operations):
                if isinstance(operation, Fixed):
                    stock = operation.with_fixtures(stock, part, operations[:k])
        except TandemError as error:
            issues += [_placed(issue, document) for issue in error.issues]
    if spec is None or cell is None or stock is None or issues:
        raise TandemError(issues)
    source = resolved(document.data, path.parent)
    problem = Problem(
        name=spec.name,
        cell=cell,
        stock=stock,
        part=part,
        operations=tuple(operations),
        settings=spec.settings.build(),
        path=path,
        digest=digest(source),
        source=source,
        changes=changes,
        accept=spec.accept,
        forces=forces,
    )
    problem = grip_choice.with_choices(problem, _without_grip(spec, setups))
    issues = [_placed(issue, document) for issue in stock_file.check_setups(problem)]
    issues += [_placed(issue, document) for issue in loads.faults(problem)]
    issues += [_placed(issue, document) for issue in axes.turntable_faults(problem)]
    issues += [_placed(issue, document) for issue in rails.following_faults(problem)]
    issues += [_placed(issue, document) for issue in rails.carrying_faults(problem)]
    issues = grip_choice.advised(problem, issues)
    if issues:
        raise TandemError(issues)
    return _with_first_steps(problem)


def _part_faults(document: Document) -> list[Issue]:
    """Faults of the part of a file whose other fields have some, so that one run tells both; none where its
    own fields, or those of the block's size, are at fault."""
    data, folder = document.data, document.path.parent
    given, sheet, own = (data.get(key) for key in ("stock", "sheet", "part"))
    block = {"size_mm": given.get("size_mm")} if isinstance(given, dict) else None
    part, wrong = validate(PartFile, own, document, ("part",))
    size, faults = (
        validate(StockFile, block, document, ()) if block else validate(SheetFile, sheet, document, ())
    )
    if wrong or faults:
        return []
    try:
        stock = sheet_file.stock(size) if isinstance(size, SheetFile) else stock_file.stock(size, folder)
        part_file.build(part, folder, stock)
    except TandemError as error:
        return [_placed(issue, document) for issue in error.issues if issue.field != "sheet.metal"]
    return []


def _without_grip(spec: ProblemFile, setups: Mapping[int, SetupFile]) -> set[int]:
    """Operations before which an arm takes up a block, without a word of how."""
    first = {0} if spec.stock is not None and spec.stock.grip is None else set()
    return first | {i for i, setup in setups.items() if setup.held_by is not None and setup.grip is None}


def _with_first_steps(problem: Problem) -> Problem:
    """The problem with what the operator does before the first operation, where anything is changed or
    held."""
    steps = stock_file.first_steps(problem)
    first = problem.changes.get(0, Change())
    if not steps:
        return problem
    own = [step for step in first.steps if step not in steps and not step.startswith("Clamp the block")]
    changes = {**problem.changes, 0: dataclasses.replace(first, steps=(*steps, *own))}
    return dataclasses.replace(problem, changes=changes)


def read_setup(raw: Any, index: int, document: Document) -> tuple[SetupFile | None, list[Issue]]:
    """The setup that an operation asks for, common to all processes."""
    if not isinstance(raw, dict) or "setup" not in raw:
        return None, []
    setup, faults = validate(SetupFile, raw["setup"], document, ("operations", index, "setup"))
    return setup, faults


def read_forces(raw: Any, index: int, document: Document) -> tuple[dict[str, Force], list[Issue]]:
    """The forces {arm: force} that an operation states, common to all processes."""
    if not isinstance(raw, dict) or "forces" not in raw:
        return {}, []
    made, found = validate(ForcesFile, {"forces": raw["forces"]}, document, ("operations", index))
    return {} if made is None else {arm: one.value() for arm, one in made.forces.items()}, found


def _changes(
    setups: Mapping[int, SetupFile], cell: Cell, folder: Path, document: Document
) -> tuple[dict[int, Change], list[Issue]]:
    changes: dict[int, Change] = {}
    issues: list[Issue] = []
    for index, setup in setups.items():
        try:
            changes[index] = stock_file.change(setup, cell.arms, folder, index)
        except TandemError as error:
            issues += [_placed(issue, document) for issue in error.issues]
    return changes, issues


def validate(
    model: type[Any], data: Any, document: Document, prefix: tuple[str | int, ...]
) -> tuple[Any, list[Issue]]:
    """Data as a value of a schema, None with faults; ``prefix`` is where the document has them."""
    try:
        # as JSON, because its strict rules take a list for a tuple but no text or truth value for a number
        text = json.dumps(data)
        return model.model_validate_json(text, strict=True, context={"folder": document.path.parent}), []
    except ValidationError as error:
        told = [dict(e) for e in error.errors() if not _emptied(dict(e))]
        return None, [_field_issue(e, document, prefix, data) for e in told]


def _emptied(error: dict[str, Any]) -> bool:
    """Whether a list is called too short only because its entries have faults, which are told themselves."""
    got = error.get("input")
    return (
        error["type"] == "too_short"
        and isinstance(got, list)
        and len(got) >= error.get("ctx", {}).get("min_length", 0)
    )


_NAME: Final = re.compile(r"\^\[A-Za-z\]\[A-Za-z0-9_\]\{0,(\d+)\}\$")
"""A pattern of names, as errors have it."""


def _field_issue(
    error: dict[str, Any], document: Document, prefix: tuple[str | int, ...], data: Any
) -> Issue:
    location = (*prefix, *_as_written(error["loc"], data))
    field = ".".join(str(step) for step in location)
    got = error.get("input")
    shown = "" if error["type"] == "missing" or isinstance(got, dict | list) else f", got {reprlib.repr(got)}"
    code = "problem.not_finite" if error["type"] == "finite_number" else "problem.field"
    remedy = {
        "missing": "add it",
        "extra_forbidden": "remove it or correct its spelling",
        "finite_number": "give a finite number",
    }.get(error["type"], "correct it")
    what = "unknown key" if error["type"] == "extra_forbidden" else error["msg"]
    if error["type"] == "too_short":
        least, has = error["ctx"]["min_length"], error["ctx"]["actual_length"]
        what = f"has {has} {'entry' if has == 1 else 'entries'}, at least {least} must be there"
        remedy = "add what is missing, or take the key out where it may be left out"
    if (several := rails.chained(location, got)) is not None:
        what, remedy = several
    if error["type"] == "missing" and isinstance(error["loc"][-1], int):  # of a list of a fixed length
        what, remedy = f"entry {error['loc'][-1]}, counted from 0, is missing", "give as many as it takes"
    if error["type"] in ("tuple_type", "list_type"):
        what, remedy = "a list is wanted", "put it in brackets: [..]"
    name = _NAME.fullmatch(error.get("ctx", {}).get("pattern", ""))
    if name:
        most = int(name[1]) + 1
        what = (
            f"names have a letter of A to Z first, then such letters, digits and _, at most {most} characters"
        )
    return Issue(
        code,
        f"{field}: {what}{shown}; {remedy}",
        file=document.name,
        line=document.line(location),
        field=field,
    )


def _as_written(location: tuple[str | int, ...], data: Any) -> Iterator[str | int]:
    """The steps of ``location`` that the file has; pydantic puts the names of chosen alternatives between
    them.
    """
    for number, step in enumerate(location):
        last = number == len(location) - 1
        if isinstance(data, dict) and (step in data or (last and isinstance(step, str))):
            data = data.get(step)
        elif isinstance(data, list) and isinstance(step, int) and step < len(data):
            data = data[step]
        else:
            continue
        yield step


def read_operation(
    raw: Any, index: int, document: Document, models: OperationModels
) -> tuple[Operation | None, list[Issue]]:
    """The operation number ``index`` of a problem by its process's schema, None with faults."""
    place: tuple[str | int, ...] = ("operations", index)
    if not isinstance(raw, dict):
        return None, []
    process = raw.get("process")
    model = models.get(process) if isinstance(process, str) else None
    if model is None:
        known = ", ".join(sorted(models))
        return None, [
            Issue(
                "problem.unknown_process",
                f"operations.{index}.process: got {process!r}, known are {known}; choose one of them",
                file=document.name,
                line=document.line((*place, "process")),
                field=f"operations.{index}.process",
            )
        ]
    if isinstance(model, Issue):
        line, field = document.line((*place, "process")), f"operations.{index}.process"
        return None, [dataclasses.replace(model, file=document.name, line=line, field=field)]
    own = {key: value for key, value in raw.items() if key not in ("setup", "forces")}
    operation, faults = validate(model, own, document, place)
    return operation, faults


def _cell(spec: str | CellFile, document: Document) -> Cell:
    if isinstance(spec, CellFile):
        return _built(spec, document, ("cell",))
    path = document.path.parent / spec
    if not is_file(path):
        what = f"cell: no file {path}; check the path, which starts at the folder of the problem file"
        raise refusal(
            "problem.missing_file", what, file=document.name, line=document.line(("cell",)), field="cell"
        )
    return read_cell(strict_yaml.read(path))


def read_cell(document: Document) -> Cell:
    """The cell of a file of its own; raises `TandemError` with every fault and its line."""
    spec, issues = validate(CellFile, document.data, document, ())
    if spec is None:
        raise TandemError(issues)
    return _built(spec, document, ())


def _built(spec: CellFile, document: Document, prefix: tuple[str | int, ...]) -> Cell:
    try:
        return cell_file.build(spec, document.path.parent)
    except TandemError as error:
        field = ".".join(str(step) for step in prefix)
        raise TandemError(
            [
                _placed(
                    dataclasses.replace(i, field=".".join(filter(None, (field, i.field))) or None), document
                )
                for i in error.issues
            ]
        ) from error


def _placed(issue: Issue, document: Document) -> Issue:
    """The issue with this file and the line of its field, unless it names a file of its own."""
    if issue.file is not None or issue.field is None:
        return issue
    steps = tuple(int(step) if step.isdigit() else step for step in issue.field.split("."))
    return dataclasses.replace(issue, file=document.name, line=document.line(steps))


def _names(cell: Cell, operations: list[Operation], document: Document) -> Iterator[Issue]:
    file = document.name
    groups = {
        "cell.arms": [arm.name for arm in cell.arms],
        "cell.obstacles": [body.name for body in cell.obstacles],
        "operations": [operation.name for operation in operations],
    }
    for field, names in groups.items():
        for name in sorted({n for n in names if [m.lower() for m in names].count(n.lower()) > 1}):
            yield Issue(
                "problem.duplicate_name",
                f"{field}: the name '{name}' is given more than once; rename one",
                file=file,
                field=field,
                line=document.line((field.split(".")[0],)),
            )
    known = [arm.name for arm in cell.arms]
    for index, operation in enumerate(operations):
        for arm in operation.arms:
            if arm not in known:
                yield Issue(
                    "problem.unknown_arm",
                    f"operations.{index}.arms: '{arm}' is not an arm of the cell; it has {', '.join(known)}",
                    file=file,
                    field=f"operations.{index}.arms",
                    line=document.line(("operations", index, "arms")),
                )
