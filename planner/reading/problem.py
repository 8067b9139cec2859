"""Reader of problem files: parse, validate every field, collect all faults, convert to SI units.

Operations belong to processes, so the caller passes their schemas; this module knows none. Problems can be
bundled: file names are made absolute, files packed, or hashed in a digest.
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

from planner.catalogue.robots import bundled_path
from planner.files import bundled_name, is_file, map_file_names
from planner.geometry.units import DEG, MM
from planner.issue_codes import all_codes, format_message
from planner.issues import Issue, TandemError, issue_error
from planner.problem import Cell, Force, HasFixtures, Operation, Problem, Settings, SetupChange
from planner.reading import cell as cell_file
from planner.reading import (
    controller,
    grip_choice,
    materials,
    process_forces,
    rail_axes,
    rotary_axes,
    strict_yaml,
)
from planner.reading import part as part_file
from planner.reading import sheet as sheet_file
from planner.reading import stock as stock_file
from planner.reading.cell import CellFile
from planner.reading.part import PartFile
from planner.reading.process_forces import ForcesFile
from planner.reading.robot_file import with_meshes
from planner.reading.sheet import SheetFile
from planner.reading.stock import SetupFile, StockFile
from planner.reading.strict_yaml import Document, Name, Strict, WordOrMapping


def find_problem(path: Path) -> Path:
    """Return the problem file, the one in the folder of that name, or the bundled one of that name."""
    for candidate in (path, path / "problem.yaml", bundled_path(path), bundled_path(path / "problem.yaml")):
        if is_file(candidate):
            return candidate
    return path


def bundle(problem: Problem) -> dict[str, bytes]:
    """Return the contents of self-contained files of a problem by their names, see :func:`pack_files`."""
    return pack_files(problem.source)


def pack_files(source: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the contents of self-contained files by their names, from the values of a problem.

    ``problem.yaml`` has the cell inlined. The files that it names are in ``files/``, under the user's names
    with hashes. Reading them gives a problem with the same digest, so a result folder can be proven wherever
    it is copied.

    Args:
        source: Values of the problem, as from :func:`resolve_files`.

    Raises:
        OSError: If a file is missing.
    """
    files: dict[str, bytes] = {}

    def bundle_file(path: Path) -> str:
        content = path.read_bytes()
        name = f"files/{bundled_name(path.name, hashlib.sha256(content).hexdigest())}"
        files[name] = content
        return name

    text = strict_yaml.dump(map_file_names(source, bundle_file))
    return {"problem.yaml": text.encode(), **files}


def resolve_files(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the data of a file with its cell inlined and all file names made absolute."""
    out: dict[str, Any] = map_file_names(data, lambda path: str(folder / path))
    cell_folder = folder
    if isinstance(data.get("cell"), str):
        path = folder / data["cell"]
        cell_folder = path.parent
        out["cell"] = map_file_names(strict_yaml.read(path).data, lambda name: str(path.parent / name))
    cell = out.get("cell")
    arms = cell.get("arms") if isinstance(cell, dict) else None
    for arm in arms if isinstance(arms, list) else ():
        if isinstance(arm, dict) and isinstance(arm.get("robot"), dict):
            arm["robot"] = with_meshes(arm["robot"], cell_folder)
    return out


def problem_digest(source: Mapping[str, Any]) -> str:
    """Return the digest of a problem, which each program carries: SHA-256 over its values and its files.

    File locations, comments and visual meshes have no effect.
    """

    def file_hash(path: Path) -> str:
        return hashlib.sha256(path.read_bytes()).hexdigest() if is_file(path) else "missing"

    text = json.dumps(map_file_names(_without_visuals(source), file_hash), sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _without_visuals(source: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a problem without visual meshes, so that the digest does not depend on them."""
    out = dict(source)
    cell = out.get("cell")
    if isinstance(cell, Mapping) and isinstance(cell.get("arms"), list):
        out["cell"] = {**cell, "arms": [_arm_without_visuals(arm) for arm in cell["arms"]]}
    return out


def _arm_without_visuals(arm: Any) -> Any:
    robot = arm.get("robot") if isinstance(arm, Mapping) else None
    if not isinstance(robot, Mapping):
        return arm
    return {**arm, "robot": {key: value for key, value in robot.items() if key != "visuals"}}


OperationModels = Mapping[str, type[BaseModel] | Issue]


class SettingsFile(Strict):
    """Limits that planning and proof share.

    ``clearance_mm`` applies to all pairs of bodies: arms, tools, block, obstacles, wires.
    ``own_clearance_mm`` replaces it between base, links and tool of one arm, and must not be larger. It does
    not apply to the arm's wire, cutter or forming head, nor to a block that it holds. The default is 5, or
    ``clearance_mm`` if that is less.
    """

    clearance_mm: float = Field(default=Settings.clearance / MM, ge=0, le=500)
    own_clearance_mm: Annotated[float, Field(ge=0, le=500)] | None = None
    speed_fraction: float = Field(default=Settings.speed_fraction, ge=0.01, le=1)
    acceleration_fraction: float = Field(default=Settings.acceleration_fraction, ge=0.01, le=1)
    joint_margin_deg: float = Field(default=Settings.joint_margin / DEG, ge=0, le=45)
    singularity_margin_deg: float = Field(default=Settings.singularity_margin / DEG, ge=0, le=45)
    tcp_speed_mm_s: float = Field(default=Settings.tcp_speed / MM, ge=1, le=5000)
    seed: int = Field(default=Settings.seed, ge=0, lt=2**31)

    @model_validator(mode="after")
    def _own_clearance_is_less(self) -> "SettingsFile":
        if self.own_clearance_mm is not None and self.own_clearance_mm > self.clearance_mm:
            raise ValueError(
                f"own_clearance_mm is {self.own_clearance_mm:g}, allowed is at most clearance_mm, here "
                f"{self.clearance_mm:g}: lower it, or widen clearance_mm, which holds for all bodies"
            )
        return self

    def to_settings(self) -> Settings:
        """Convert the settings to SI units."""
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


def _require_acceptable(code: str) -> str:
    """Return the code of an error that a problem may accept. Raises ``ValueError`` for other codes."""
    acceptable = sorted(name for name, row in all_codes().items() if row.acceptance)
    if code not in acceptable:
        raise ValueError(f"this cannot be accepted; acceptable are {', '.join(acceptable)}")
    return code


class ProblemFile(Strict):
    """A whole problem file, schema version 1. Each operation is validated by the schema of its process."""

    tandem: Literal[1]
    name: Name
    cell: Annotated[
        Annotated[str, Tag("word"), Field(max_length=1000)] | Annotated[CellFile, Tag("mapping")],
        WordOrMapping,
    ]
    stock: StockFile | None = None
    sheet: SheetFile | None = Field(default=None, description="a clamped sheet to form, in place of a block")
    part: PartFile | None = None
    settings: SettingsFile = SettingsFile()
    accept: tuple[Annotated[str, Field(max_length=60), AfterValidator(_require_acceptable)], ...] = Field(
        default=(), max_length=20, description="codes of errors that are known and intended, see below"
    )
    operations: list[dict[str, Any]] = Field(min_length=1)

    @model_validator(mode="after")
    def _one_stock(self) -> Self:
        if (self.stock is None) == (self.sheet is None):
            raise ValueError("stock: give either the block as stock, or the sheet to form as sheet")
        return self


def read_problem(path: Path, models: OperationModels) -> Problem:
    """Read, validate and convert the problem file at ``path``.

    Args:
        path: Problem file.
        models: Schema of the operation of each process.

    Raises:
        TandemError: With all faults, each with its field and, if the format gives it, its line.
    """
    return build_problem(strict_yaml.read(path), models)


def build_problem(document: Document, models: OperationModels) -> Problem:
    """Validate and convert a parsed problem file. Parameters and errors are as in :func:`read_problem`."""
    path = document.path
    spec, issues = validate(ProblemFile, document.data, document, ())
    # operations by the schemas of their processes
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
            operation_forces, faults = read_forces(raw, index, document)
            issues += faults
            if operation_forces:
                forces[index] = operation_forces
            operation, faults = read_operation(raw, index, document, models)
            issues += faults
            if operation is not None:
                operations.append(operation)
    # cell, and what operations require of it
    cell = None
    if spec is not None:
        try:
            cell = _read_cell(spec.cell, document)
        except TandemError as error:
            issues += error.issues
    if cell is not None and spec is not None and spec.stock is not None:
        try:
            cell = stock_file.mount_gripper(cell, spec.stock)
        except TandemError as error:
            issues += [_with_line(issue, document) for issue in error.issues]
    if cell is not None:
        issues += _name_faults(cell, operations, document)
        issues += [_with_line(issue, document) for issue in controller.controller_faults(cell, operations)]
        issues += [_with_line(issue, document) for issue in materials.wire_faults(cell.wires, operations)]
    # stock and part; faults so far do not prevent the check of the part
    part, stock = None, None
    changes: dict[int, SetupChange] = {}
    if spec is not None:
        try:
            if spec.sheet is not None:
                stock = sheet_file.build_sheet_stock(spec.sheet)
            elif spec.stock is not None:
                stock = stock_file.build_stock(spec.stock, path.parent)
        except TandemError as error:
            issues += [_with_line(issue, document) for issue in error.issues]
            issues += _part_faults(document)
    else:
        issues += _part_faults(document)
    if cell is not None:
        changes, faults = _build_changes(setups, cell, path.parent, document)
        issues += faults
    if spec is not None and spec.part is not None and stock is not None:
        try:
            part = part_file.build_part(spec.part, path.parent, stock)
            stock = sheet_file.with_formed_solids(stock, part)
            for k, operation in enumerate(operations):
                if isinstance(operation, HasFixtures):
                    stock = operation.with_fixtures(stock, part, operations[:k])
        except TandemError as error:
            issues += [_with_line(issue, document) for issue in error.issues]
    if spec is None or cell is None or stock is None or issues:
        raise TandemError(issues)
    source = resolve_files(document.data, path.parent)
    problem = Problem(
        name=spec.name,
        cell=cell,
        stock=stock,
        part=part,
        operations=tuple(operations),
        settings=spec.settings.to_settings(),
        path=path,
        digest=problem_digest(source),
        source=source,
        changes=changes,
        accept=spec.accept,
        forces=forces,
    )
    # grips, then checks that need the whole problem
    problem = grip_choice.choose_grips(problem, _operations_without_grip(spec, setups))
    issues = [_with_line(issue, document) for issue in stock_file.check_setups(problem)]
    issues += [_with_line(issue, document) for issue in process_forces.force_faults(problem)]
    issues += [_with_line(issue, document) for issue in rotary_axes.turntable_faults(problem)]
    issues += [_with_line(issue, document) for issue in rail_axes.coordinated_track_faults(problem)]
    issues += [_with_line(issue, document) for issue in rail_axes.carrying_faults(problem)]
    issues = grip_choice.add_grip_advice(problem, issues)
    if issues:
        raise TandemError(issues)
    return _with_first_steps(problem)


def _part_faults(document: Document) -> list[Issue]:
    """Return faults of the part if other fields have faults, so that one run reports both.

    Empty if the fields of the part itself, or of the size of the block, have faults.
    """
    data, folder = document.data, document.path.parent
    stock_data, sheet, part_data = (data.get(key) for key in ("stock", "sheet", "part"))
    block_data = {"size_mm": stock_data.get("size_mm")} if isinstance(stock_data, dict) else None
    part, part_faults = validate(PartFile, part_data, document, ("part",))
    stock_spec, faults = (
        validate(StockFile, block_data, document, ())
        if block_data
        else validate(SheetFile, sheet, document, ())
    )
    if part_faults or faults:
        return []
    try:
        stock = (
            sheet_file.build_sheet_stock(stock_spec)
            if isinstance(stock_spec, SheetFile)
            else stock_file.build_stock(stock_spec, folder)
        )
        part_file.build_part(part, folder, stock)
    except TandemError as error:
        return [_with_line(issue, document) for issue in error.issues if issue.field != "sheet.metal"]
    return []


def _operations_without_grip(spec: ProblemFile, setups: Mapping[int, SetupFile]) -> set[int]:
    """Return the operations before which an arm takes up a block without a stated grip."""
    first_operations = {0} if spec.stock is not None and spec.stock.grip is None else set()
    return first_operations | {
        i for i, setup in setups.items() if setup.held_by is not None and setup.grip is None
    }


def _with_first_steps(problem: Problem) -> Problem:
    """Add the instructions for the operator before the first operation, if anything is changed or held."""
    steps = stock_file.first_instructions(problem)
    first = problem.changes.get(0, SetupChange())
    if not steps:
        return problem
    other_steps = [
        step for step in first.steps if step not in steps and not step.startswith("Clamp the block")
    ]
    changes = {**problem.changes, 0: dataclasses.replace(first, steps=(*steps, *other_steps))}
    return dataclasses.replace(problem, changes=changes)


def read_setup(raw: Any, index: int, document: Document) -> tuple[SetupFile | None, list[Issue]]:
    """Read the setup of an operation, which is common to all processes.

    Returns:
        Setup, None if there is none or it is invalid; and the faults.
    """
    if not isinstance(raw, dict) or "setup" not in raw:
        return None, []
    setup, faults = validate(SetupFile, raw["setup"], document, ("operations", index, "setup"))
    return setup, faults


def read_forces(raw: Any, index: int, document: Document) -> tuple[dict[str, Force], list[Issue]]:
    """Read the forces of an operation, which are common to all processes.

    Returns:
        Forces by arm, empty if there are none or they are invalid; and the faults.
    """
    if not isinstance(raw, dict) or "forces" not in raw:
        return {}, []
    forces, faults = validate(ForcesFile, {"forces": raw["forces"]}, document, ("operations", index))
    return {} if forces is None else {arm: force.to_force() for arm, force in forces.forces.items()}, faults


def _build_changes(
    setups: Mapping[int, SetupFile], cell: Cell, folder: Path, document: Document
) -> tuple[dict[int, SetupChange], list[Issue]]:
    """Return the changes before operations by their indices, and the faults of invalid ones."""
    changes: dict[int, SetupChange] = {}
    issues: list[Issue] = []
    for index, setup in setups.items():
        try:
            changes[index] = stock_file.build_change(setup, cell.arms, folder, index)
        except TandemError as error:
            issues += [_with_line(issue, document) for issue in error.issues]
    return changes, issues


def validate(
    model: type[Any], data: Any, document: Document, prefix: tuple[str | int, ...]
) -> tuple[Any, list[Issue]]:
    """Validate data by a schema.

    Args:
        model: Schema.
        data: Data.
        document: Document with the data.
        prefix: Path of the data in the document.

    Returns:
        Value, or None if there are faults; and the faults.
    """
    try:
        # as JSON, whose strict rules accept a list for a tuple but no text or boolean for a number
        text = json.dumps(data)
        return model.model_validate_json(text, strict=True, context={"folder": document.path.parent}), []
    except ValidationError as error:
        errors = [dict(e) for e in error.errors() if not _is_emptied(dict(e))]
        return None, [_field_issue(e, document, prefix, data) for e in errors]


def _is_emptied(error: dict[str, Any]) -> bool:
    """Whether a list counts as too short only because its entries have faults, which are reported."""
    entries = error.get("input")
    return (
        error["type"] == "too_short"
        and isinstance(entries, list)
        and len(entries) >= error.get("ctx", {}).get("min_length", 0)
    )


_NAME: Final = re.compile(r"\^\[A-Za-z\]\[A-Za-z0-9_\]\{0,(\d+)\}\$")
"""Pattern of names, as it appears in validation errors."""


def _field_issue(
    error: dict[str, Any], document: Document, prefix: tuple[str | int, ...], data: Any
) -> Issue:
    """Return the issue of a pydantic error with field and line; ``data`` is at ``prefix`` of the file."""
    location = (*prefix, *_steps_in_file(error["loc"], data))
    field = ".".join(str(step) for step in location)
    value = error.get("input")
    value_text = (
        "" if error["type"] == "missing" or isinstance(value, dict | list) else f", got {reprlib.repr(value)}"
    )
    code = "problem.not_finite" if error["type"] == "finite_number" else "problem.field"
    remedy = {
        "missing": "add it",
        "extra_forbidden": "remove it or correct its spelling",
        "finite_number": "give a finite number",
    }.get(error["type"], "correct it")
    fault = "unknown key" if error["type"] == "extra_forbidden" else error["msg"]
    if error["type"] == "too_short":
        min_length, length = error["ctx"]["min_length"], error["ctx"]["actual_length"]
        fault = f"has {length} {'entry' if length == 1 else 'entries'}, at least {min_length} required"
        remedy = "add the missing ones, or remove the key if it is optional"
    axes_fault = rail_axes.linear_axes_fault(location, value)
    if axes_fault is not None:
        fault, remedy = axes_fault
    if error["type"] == "missing" and isinstance(error["loc"][-1], int):  # of a list of a fixed length
        fault, remedy = f"entry {error['loc'][-1]}, counted from 0, is missing", "give all entries"
    if error["type"] in ("tuple_type", "list_type"):
        fault, remedy = "expected a list", "put it in brackets: [..]"
    name = _NAME.fullmatch(error.get("ctx", {}).get("pattern", ""))
    if name:
        max_length = int(name[1]) + 1
        fault = (
            f"names start with a letter A to Z, then letters, digits and _, at most {max_length} characters"
        )
    return Issue(
        code,
        f"{field}: {fault}{value_text}; {remedy}",
        file=document.name,
        line=document.line(location),
        field=field,
    )


def _steps_in_file(location: tuple[str | int, ...], data: Any) -> Iterator[str | int]:
    """Yield the steps of ``location`` that the file has.

    pydantic inserts the names of chosen alternatives.
    """
    for number, step in enumerate(location):
        is_last = number == len(location) - 1
        if isinstance(data, dict) and (step in data or (is_last and isinstance(step, str))):
            data = data.get(step)
        elif isinstance(data, list) and isinstance(step, int) and step < len(data):
            data = data[step]
        else:
            continue
        yield step


def read_operation(
    raw: Any, index: int, document: Document, models: OperationModels
) -> tuple[Operation | None, list[Issue]]:
    """Read operation ``index`` of a problem by the schema of its process.

    Returns:
        Operation, None if it is invalid; and the faults.
    """
    location: tuple[str | int, ...] = ("operations", index)
    if not isinstance(raw, dict):
        return None, []
    process = raw.get("process")
    model = models.get(process) if isinstance(process, str) else None
    if model is None:
        known_processes = ", ".join(sorted(models))
        return None, [
            Issue(
                "problem.unknown_process",
                format_message(
                    "problem.unknown_process", index=index, process=process, known_processes=known_processes
                ),
                file=document.name,
                line=document.line((*location, "process")),
                field=f"operations.{index}.process",
            )
        ]
    if isinstance(model, Issue):
        line, field = document.line((*location, "process")), f"operations.{index}.process"
        return None, [dataclasses.replace(model, file=document.name, line=line, field=field)]
    fields = {key: value for key, value in raw.items() if key not in ("setup", "forces")}
    operation, faults = validate(model, fields, document, location)
    return operation, faults


def _read_cell(spec: str | CellFile, document: Document) -> Cell:
    """Return the cell that a problem file states, or that of the separate file that it names."""
    if isinstance(spec, CellFile):
        return _build_cell(spec, document, ("cell",))
    path = document.path.parent / spec
    if not is_file(path):
        message = f"cell: no file {path}; check the path, which is relative to the folder of the problem file"
        raise issue_error(
            "problem.missing_file", message, file=document.name, line=document.line(("cell",)), field="cell"
        )
    return read_cell(strict_yaml.read(path))


def read_cell(document: Document) -> Cell:
    """Read the cell of a separate file.

    Raises:
        TandemError: With all faults and their lines.
    """
    spec, issues = validate(CellFile, document.data, document, ())
    if spec is None:
        raise TandemError(issues)
    return _build_cell(spec, document, ())


def _build_cell(spec: CellFile, document: Document, prefix: tuple[str | int, ...]) -> Cell:
    """Convert a cell at the path ``prefix`` of a document. Faults get their field and line there."""
    try:
        return cell_file.build_cell(spec, document.path.parent)
    except TandemError as error:
        field = ".".join(str(step) for step in prefix)
        raise TandemError(
            [
                _with_line(
                    dataclasses.replace(i, field=".".join(filter(None, (field, i.field))) or None), document
                )
                for i in error.issues
            ]
        ) from error


def _with_line(issue: Issue, document: Document) -> Issue:
    """Return the issue with this file and the line of its field, unless it names a file of its own."""
    if issue.file is not None or issue.field is None:
        return issue
    steps = tuple(int(step) if step.isdigit() else step for step in issue.field.split("."))
    return dataclasses.replace(issue, file=document.name, line=document.line(steps))


def _name_faults(cell: Cell, operations: list[Operation], document: Document) -> Iterator[Issue]:
    """Yield faults of repeated names of arms, obstacles or operations, and of unknown arms."""
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
    arm_names = [arm.name for arm in cell.arms]
    for index, operation in enumerate(operations):
        for arm in operation.arms:
            if arm not in arm_names:
                yield Issue(
                    "problem.unknown_arm",
                    f"operations.{index}.arms: '{arm}' is not an arm of the cell; it has "
                    f"{', '.join(arm_names)}",
                    file=file,
                    field=f"operations.{index}.arms",
                    line=document.line(("operations", index, "arms")),
                )
