"""Strict YAML files: line of every field, fields by path, and a base of schemas that refuses unknown keys.

A refused value can be found in the file by its line. Schemas share the types of numbers, vectors and names
with their ranges.
"""

import copy
import json
import re
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    ValidationError,
    ValidationInfo,
)

from planner.files import FILE_KEYS, is_file, missing_file_reason
from planner.geometry.units import measurement
from planner.issues import Issue, TandemError, issue_error

try:  # libyaml, if PyYAML was built with it: twenty times faster, with the same marks
    from yaml import CSafeDumper as _SafeDumper
    from yaml import CSafeLoader as _SafeLoader
except ImportError:
    from yaml import SafeDumper as _SafeDumper  # type: ignore[assignment]
    from yaml import SafeLoader as _SafeLoader  # type: ignore[assignment]

MAX_YAML_BYTES = 5_000_000
"""Maximum size of a problem or cell file [bytes].

Larger files are refused unread; parts belong in other files.
"""


MAX_VALUES = 500_000
"""Maximum number of values in a file with aliases expanded: a few lines of aliases can expand to billions."""
MAX_DEPTH = 50
"""Maximum nesting depth of mappings and lists. Deeper ones would exhaust the stack."""
_TOO_MANY_VALUES = f"has over {MAX_VALUES} values; put meshes and point lists into separate files"
_TOO_DEEPLY_NESTED = f"is nested more than {MAX_DEPTH} deep; reduce the nesting"
"""Messages for files beyond these two limits."""
PLAIN_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "seq", "map", "merge")
}
"""YAML tags of plain values. Others would create objects."""


class _Loader(_SafeLoader):
    """SafeLoader that reads 1e-3 as a number (YAML 1.2) and a date as text."""


class _Dumper(_SafeDumper):
    """SafeDumper that quotes text which :class:`_Loader` would read as a number, and has no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write every value out, without aliases."""
        del data
        return True


for _yaml_class in (_Loader, _Dumper):
    _yaml_class.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(":timestamp")]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    _yaml_class.add_implicit_resolver(
        "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+0123456789.")
    )


def dump(data: Any) -> str:
    """Return plain data as YAML that :func:`parse` reads as equal data.

    Lists of single values are on one line.
    """
    style: dict[str, Any] = {
        "sort_keys": False,
        "allow_unicode": True,
        "default_flow_style": None,
        "width": 110,
    }
    return str(yaml.dump(data, Dumper=_Dumper, **style))


class Document:
    """A parsed file.

    Attributes:
        path: File. File names in ``data`` are relative to its folder.
        data: Content as plain values.
        text: Content as bytes.
        name: Name in messages; None for data that come from no file.
    """

    def __init__(self, path: Path, data: Any, root: yaml.Node | None, text: bytes, file: bool = True) -> None:
        self.path = path
        self.data = data
        self.text = text
        self.name = str(path) if file else None
        self._root = root

    def with_data(self, data: Any) -> "Document":
        """Return the document with other values at the same positions."""
        return Document(self.path, data, self._root, self.text, self.name is not None)

    def line(self, location: tuple[str | int, ...]) -> int | None:
        """Return the line, from 1, of the deepest part of ``location`` that the file has."""
        node, line = self._root, None
        for step in location:
            child = _child_node(node, step)
            if child is None:
                break
            node, line = child
        return line if line is not None else (1 if self._root is not None else None)


def read(path: Path) -> Document:
    """Parse a YAML file whose top level is a mapping.

    Raises:
        TandemError: ``problem.missing_file``, ``problem.too_large``, ``problem.duplicate_name`` or
            ``problem.not_yaml``.
    """
    name = str(path)
    if not is_file(path):
        raise issue_error(
            "problem.missing_file", f"{name}: {missing_file_reason(path)}; check the path", file=name
        )
    size = path.stat().st_size
    if size > MAX_YAML_BYTES:
        message = f"{name}: {size / 1e6:.1f} MB, allowed {MAX_YAML_BYTES / 1e6:.0f} MB for YAML; put "
        message += "meshes and point lists into separate files"
        raise issue_error(
            "problem.too_large", message, file=name, **measurement(size / 1e6, MAX_YAML_BYTES / 1e6, "MB")
        )
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise _yaml_error(name, f"cannot be read: {error.strerror}; check its permissions") from error
    data, root = parse(raw, name)
    return Document(path, data, root, raw)


def parse(raw: bytes, name: str) -> tuple[dict[str, Any], yaml.Node | None]:
    """Parse a YAML text whose top level is a mapping.

    Args:
        raw: Text.
        name: Name in messages.

    Returns:
        Data, and nodes with their lines.

    Raises:
        TandemError: As :func:`read`.
    """
    try:
        text = raw.decode("utf-8-sig")
        _refuse_too_large(text, name)
        root = yaml.compose(text, Loader=_Loader)
        if root is not None:
            _require_plain(root, name)
            _refuse_duplicate_keys(root, name)
        data = yaml.load(text, Loader=_Loader)  # a SafeLoader
    except RecursionError as error:
        raise _yaml_error(name, _TOO_DEEPLY_NESTED) from error
    # other than YAMLError: values that do not fit their tag
    except (yaml.YAMLError, ValueError, KeyError, AttributeError) as error:
        if "nesting depth" in str(error):  # PyYAML counts too, from 6.0.4 on
            raise _yaml_error(name, _TOO_DEEPLY_NESTED) from error
        mark = getattr(error, "problem_mark", None)
        detail = getattr(error, "problem", None) or str(error).splitlines()[0]
        line = mark.line + 1 if mark else None
        has_tabs = line is not None and "\t" in (text.splitlines()[line - 1 : line] or [""])[0]
        remedy = (
            "indent with spaces, not tabs" if has_tabs else "write a mapping, one name and value per line"
        )
        message = f"is not YAML: {detail}; {remedy}"
        raise _yaml_error(name, message, line) from error
    if not isinstance(data, dict):
        type_name = type(data).__name__ if data is not None else "nothing"
        message = f"has {type_name} at its top level; write a mapping, one name and value per line"
        raise _yaml_error(name, message, 1)
    return data, root


def set_field(data: dict[str, Any], path: str, value: Any, folder: Path) -> None:
    """Set a field of ``data``.

    Missing mappings on the path are created, so that the schema of the problem reports unknown keys.

    Args:
        data: Data to change.
        path: Path of the field, with dots.
        value: New value.
        folder: Folder to which file names in the value are relative.

    Raises:
        ValueError: If a list has no such entry, or a value is on the path; the text names the step.
    """
    steps = path.split(".")
    if not all(steps):
        raise ValueError(f"{path!r} is not a path; write names and numbers separated by single dots")
    node: Any = data
    for i, step in enumerate(steps[:-1]):
        key = _key(node, step, ".".join(steps[: i + 1]))
        if isinstance(node, dict) and node.get(key) is None:
            node[key] = {}
        node = node[key]
    last = _key(node, steps[-1], path)
    node[last] = _with_absolute_files(copy.deepcopy(value), folder, steps[-1])


def _key(node: Any, step: str, path: str) -> str | int:
    """Return the key of a step in a mapping, or its index in a list by number or by an entry's name.

    Raises:
        ValueError: If a list has no such entry, or the node is a single value.
    """
    if isinstance(node, dict):
        return step
    if not isinstance(node, list):
        raise ValueError(f"{path} is below a single value; end the path there")
    if step.isdecimal():
        if int(step) >= len(node):
            raise ValueError(f"{path}: the list has {len(node)} entries, counted from 0; choose one of them")
        return int(step)
    matches = [i for i, entry in enumerate(node) if isinstance(entry, dict) and entry.get("name") == step]
    if len(matches) != 1:
        known_names = ", ".join(str(e["name"]) for e in node if isinstance(e, dict) and "name" in e) or "none"
        raise ValueError(
            f"{path}: {len(matches)} entries have that name, known are {known_names}; choose one"
        )
    return matches[0]


def _with_absolute_files(value: Any, folder: Path, key: str) -> Any:
    """Return the value of a key with all file names in it relative to ``folder`` made absolute."""
    if key in FILE_KEYS and isinstance(value, str):
        return str((folder / value).resolve())
    if isinstance(value, dict):
        return {k: _with_absolute_files(v, folder, k) for k, v in value.items()}
    if isinstance(value, list):
        return [_with_absolute_files(v, folder, "") for v in value]
    return value


def _child_node(node: yaml.Node | None, step: str | int) -> tuple[yaml.Node, int] | None:
    """Return the node of a key or index below a node, and its line from 1; None if there is none."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if key.value == str(step):
                return value, key.start_mark.line + 1
    if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
        child = node.value[step]
        return child, child.start_mark.line + 1
    return None


def _yaml_error(name: str, message: str, line: int | None = None) -> TandemError:
    return issue_error("problem.not_yaml", f"{name} {message}", file=name, line=line)


def _refuse_too_large(text: str, name: str) -> None:
    """Count values and depth of a text before it is composed.

    Composing what 5 MB can hold takes minutes. Each value has at most one key.
    """
    nodes = depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.NodeEvent):
            nodes += 1
            depth += isinstance(event, yaml.CollectionStartEvent)
        if nodes > 2 * MAX_VALUES or depth > MAX_DEPTH:
            line = event.start_mark.line + 1 if event.start_mark else None
            raise _yaml_error(name, _TOO_DEEPLY_NESTED if depth > MAX_DEPTH else _TOO_MANY_VALUES, line)


def _require_plain(root: yaml.Node, name: str) -> None:
    """Refuse everything but text, numbers, lists and mappings with text keys, loops, and too many values."""
    sizes: dict[int, int] = {}
    open_nodes: set[int] = set()

    def size(node: yaml.Node, depth: int) -> int:
        line = node.start_mark.line + 1
        if id(node) in open_nodes:
            raise _yaml_error(name, "has an alias that contains itself; write the values out", line)
        if depth > MAX_DEPTH:
            raise _yaml_error(name, _TOO_DEEPLY_NESTED, line)
        if node.tag not in PLAIN_TAGS:
            raise _yaml_error(name, f"has a value with the tag {node.tag!r}; write plain values", line)
        if isinstance(node, yaml.ScalarNode):
            if any("\ud800" <= letter <= "\udfff" for letter in node.value):
                raise _yaml_error(name, "has half a character (a lone surrogate); remove it", line)
            return 1
        if id(node) in sizes:
            return sizes[id(node)]
        children = node.value
        if isinstance(node, yaml.MappingNode):
            for key, _ in node.value:
                if key.tag not in ("tag:yaml.org,2002:str", "tag:yaml.org,2002:merge"):
                    message = f"has the key {key.value!r}, which is not text; write it as a name"
                    raise _yaml_error(
                        name,
                        message
                        if isinstance(key, yaml.ScalarNode)
                        else "has a key that is not text; write a name",
                        key.start_mark.line + 1,
                    )
            children = [value for _, value in node.value]
        open_nodes.add(id(node))
        total = 1 + sum(size(child, depth + 1) for child in children)
        open_nodes.remove(id(node))
        if total > MAX_VALUES:
            raise _yaml_error(name, _TOO_MANY_VALUES, line)
        sizes[id(node)] = total
        return total

    size(root, 0)


def _refuse_duplicate_keys(node: yaml.Node, name: str) -> None:
    """Refuse repeated keys, of which YAML would silently keep the last."""
    stack: list[yaml.Node] = [node]
    seen_nodes: set[int] = set()
    while stack:
        current = stack.pop()
        if id(current) in seen_nodes:
            continue
        seen_nodes.add(id(current))
        if isinstance(current, yaml.MappingNode):
            seen: set[str] = set()
            for key, value in current.value:
                if key.value in seen:
                    message = f"key '{key.value}' occurs twice in one mapping; keep one"
                    raise issue_error(
                        "problem.duplicate_name",
                        message,
                        file=name,
                        line=key.start_mark.line + 1,
                        field=str(key.value),
                    )
                seen.add(key.value)
                stack.append(value)
        elif isinstance(current, yaml.SequenceNode):
            stack.extend(current.value)


Coordinate = Annotated[float, Field(ge=-100_000, le=100_000)]
"""A coordinate [mm]. Chosen: no cell is larger than 100 m."""
Angle = Annotated[float, Field(ge=-720, le=720)]
"""An angle [deg]."""
Vector = tuple[Coordinate, Coordinate, Coordinate]
Positive = Annotated[float, Field(ge=0.01, le=100_000)]
"""A length [mm] of a body."""
Fraction = Annotated[float, Field(ge=0, le=1)]
Scale = Annotated[float, Field(gt=0, le=100_000)]
Unit = Literal["mm", "cm", "m", "in", "ft"]


def _require_unit(unit: Unit | None, read: ValidationInfo) -> Unit | None:
    """Validate the unit of the ``file`` above it. It may be omitted for files that state their own."""
    from planner.geometry.mesh_files import UNIT_SUFFIXES  # lazy: imports numpy, which most files do not need

    file = read.data.get("file")
    if unit is None and file is not None and not file.lower().endswith(UNIT_SUFFIXES):
        raise ValueError("is required, as unit: mm; only GLB and 3MF files state their own")
    return unit


FileUnit = Annotated[
    Unit | None,
    AfterValidator(_require_unit),
    Field(description="of its lengths; GLB and 3MF files state their own", validate_default=True),
]
"""Unit of a file; optional if the file states its own."""
Name = Annotated[
    str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,23}$", description="letter first, at most 24 characters")
]
FileName = Annotated[str, Field(min_length=1, max_length=1000)]


class Strict(BaseModel):
    """Base of every schema: unknown keys and non-finite numbers are refused, values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


_Schema = TypeVar("_Schema", bound=Strict)


def read_file(model: type[_Schema], path: Path, code: str) -> _Schema:
    """Read a file by its schema.

    Args:
        model: Schema.
        path: File.
        code: Issue code of wrong fields.

    Raises:
        TandemError: ``code`` for each wrong field, with its line, and the issues of `read`.
    """
    document = read(path)

    def fault_issue(message: str, value: object, path_in_file: tuple[str | int, ...]) -> Issue:
        return Issue(
            code,
            f"{message}; got {value!r:.80}",
            file=str(document.path),
            line=document.line(path_in_file),
            field=".".join(map(str, path_in_file)),
            hint="correct it, in the units of the field's name",
        )

    try:
        # as JSON, whose strict rules accept a list for a tuple but no text for a number
        return model.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        faults = [fault_issue(fault["msg"], fault.get("input"), fault["loc"]) for fault in error.errors()]
        raise TandemError(faults) from error


def _word_or_mapping(value: object) -> str:
    """Return which alternative a value is meant to be, so that only faults of that one are reported."""
    return "mapping" if isinstance(value, dict | list | tuple | BaseModel) else "word"


WordOrMapping = Discriminator(_word_or_mapping)
