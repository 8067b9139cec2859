"""Strict YAML files: the line of every field, fields by their paths, and a base for schemas that refuses
unknown keys.

A refused value can be found in the file by its line. Schemas share numbers, vectors and names with
their ranges.
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

from planner.files import FILE_KEYS, is_file, no_file
from planner.geometry.units import measurement
from planner.issues import Issue, TandemError, refusal

try:  # libyaml, where PyYAML was built with it: twenty times faster, and the same marks
    from yaml import CSafeDumper as _SafeDumper
    from yaml import CSafeLoader as _SafeLoader
except ImportError:
    from yaml import SafeDumper as _SafeDumper  # type: ignore[assignment]
    from yaml import SafeLoader as _SafeLoader  # type: ignore[assignment]

MAX_YAML_BYTES = 5_000_000
"""A problem or cell file larger than this is refused unread; parts belong in files of their own."""


MAX_VALUES = 500_000
"""At most so many values in a file, aliases written out: a few lines of them can stand for billions."""
MAX_DEPTH = 50
"""Mappings and lists inside one another at most: deeper ones would exhaust the stack."""
_TOO_MANY_VALUES = f"has over {MAX_VALUES} values; put meshes and point lists into files of their own"
_TOO_DEEPLY_NESTED = f"is nested more than {MAX_DEPTH} deep; write it flatter"
"""What is said of files beyond these two limits."""
PLAIN_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "seq", "map", "merge")
}
"""YAML tags of plain values; others would build objects."""


class _Loader(_SafeLoader):
    """SafeLoader that reads 1e-3 as a number (YAML 1.2), as people expect, and a date as text."""


class _Dumper(_SafeDumper):
    """SafeDumper that quotes text which :class:`_Loader` would read as a number, and has no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        """Whether a value is written out wherever it stands."""
        del data
        return True


for _one in (_Loader, _Dumper):
    _one.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in known if not tag.endswith(":timestamp")]
        for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    _one.add_implicit_resolver(
        "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+0123456789.")
    )


def dump(data: Any) -> str:
    """Plain data as YAML that :func:`parse` reads as the same data; lists of single values on one line."""
    style: dict[str, Any] = {
        "sort_keys": False,
        "allow_unicode": True,
        "default_flow_style": None,
        "width": 110,
    }
    return str(yaml.dump(data, Dumper=_Dumper, **style))


class Document:
    """A parsed file: ``data`` as plain values, :meth:`line` for the place of a field. ``name`` is what
    messages call it, None for data that come from no file; file names in it start at the folder of
    ``path``."""

    def __init__(self, path: Path, data: Any, root: yaml.Node | None, text: bytes, file: bool = True) -> None:
        self.path = path
        self.data = data
        self.text = text
        self.name = str(path) if file else None
        self._root = root

    def with_data(self, data: Any) -> "Document":
        """The same file with other values in the same places."""
        return Document(self.path, data, self._root, self.text, self.name is not None)

    def line(self, location: tuple[str | int, ...]) -> int | None:
        """Line, from 1, of the deepest part of ``location`` that the file has."""
        node, line = self._root, None
        for step in location:
            child = _child(node, step)
            if child is None:
                break
            node, line = child
        return line if line is not None else (1 if self._root is not None else None)


def read(path: Path) -> Document:
    """Parse a YAML file whose top level is a mapping.

    Raises ``TandemError`` with ``problem.missing_file``, ``problem.too_large``, ``problem.duplicate_name`` or
    ``problem.not_yaml``.
    """
    name = str(path)
    if not is_file(path):
        raise refusal("problem.missing_file", f"{name}: {no_file(path)}; check the path", file=name)
    size = path.stat().st_size
    if size > MAX_YAML_BYTES:
        what = f"{name}: {size / 1e6:.1f} MB, at most {MAX_YAML_BYTES / 1e6:.0f} MB are read as YAML; put "
        what += "meshes and point lists into files of their own"
        raise refusal(
            "problem.too_large", what, file=name, **measurement(size / 1e6, MAX_YAML_BYTES / 1e6, "MB")
        )
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise _not_yaml(name, f"cannot be read: {error.strerror}; see to its permissions") from error
    data, root = parse(raw, name)
    return Document(path, data, root, raw)


def parse(raw: bytes, name: str) -> tuple[dict[str, Any], yaml.Node | None]:
    """The mapping in a YAML text, and its nodes with their lines; ``name`` is what messages call it. Raises
    as :func:`read`."""
    try:
        text = raw.decode("utf-8-sig")
        _refuse_too_large(text, name)
        root = yaml.compose(text, Loader=_Loader)
        if root is not None:
            _refuse_what_is_not_plain(root, name)
            _refuse_repeated(root, name)
        data = yaml.load(text, Loader=_Loader)  # a SafeLoader
    except RecursionError as error:
        raise _not_yaml(name, _TOO_DEEPLY_NESTED) from error
    except (
        yaml.YAMLError,
        ValueError,
        KeyError,
        AttributeError,
    ) as error:  # values of a tag that are not its
        if "nesting depth" in str(error):  # PyYAML counts too, from 6.0.4 on
            raise _not_yaml(name, _TOO_DEEPLY_NESTED) from error
        mark = getattr(error, "problem_mark", None)
        detail = getattr(error, "problem", None) or str(error).splitlines()[0]
        line = mark.line + 1 if mark else None
        tabs = line is not None and "\t" in (text.splitlines()[line - 1 : line] or [""])[0]
        remedy = "indent with spaces, not tabs" if tabs else "write a mapping, a name and its value a line"
        what = f"is not YAML: {detail}; {remedy}"
        raise _not_yaml(name, what, line) from error
    if not isinstance(data, dict):
        got = type(data).__name__ if data is not None else "nothing"
        what = f"has {got} at its top level; write a mapping, a name and its value a line"
        raise _not_yaml(name, what, 1)
    return data, root


def changed_field(data: dict[str, Any], path: str, value: Any, folder: Path) -> None:
    """Set a field of ``data``; mappings that are missing on the way are made, so that the problem's schema
    says what it does not know. Names of files in the value start at ``folder``.

    Raises ``ValueError``, which names the step, where a list has no such entry, or a value is in the way.
    """
    steps = path.split(".")
    if not all(steps):
        raise ValueError(f"{path!r} is no path; write names and numbers with single dots between them")
    node: Any = data
    for i, step in enumerate(steps[:-1]):
        key = _key(node, step, ".".join(steps[: i + 1]))
        if isinstance(node, dict) and node.get(key) is None:
            node[key] = {}
        node = node[key]
    last = _key(node, steps[-1], path)
    node[last] = _with_absolute_files(copy.deepcopy(value), folder, steps[-1])


def _key(node: Any, step: str, path: str) -> str | int:
    """The key of a step in a mapping or list."""
    if isinstance(node, dict):
        return step
    if not isinstance(node, list):
        raise ValueError(f"{path} is below a single value; end the path there")
    if step.isdecimal():
        if int(step) >= len(node):
            raise ValueError(f"{path}: the list has {len(node)} entries, counted from 0; choose one of them")
        return int(step)
    named = [i for i, entry in enumerate(node) if isinstance(entry, dict) and entry.get("name") == step]
    if len(named) != 1:
        known = ", ".join(str(e["name"]) for e in node if isinstance(e, dict) and "name" in e) or "none"
        raise ValueError(f"{path}: {len(named)} entries have that name, known are {known}; choose one")
    return named[0]


def _with_absolute_files(value: Any, folder: Path, key: str) -> Any:
    if key in FILE_KEYS and isinstance(value, str):
        return str((folder / value).resolve())
    if isinstance(value, dict):
        return {k: _with_absolute_files(v, folder, k) for k, v in value.items()}
    if isinstance(value, list):
        return [_with_absolute_files(v, folder, "") for v in value]
    return value


def _child(node: yaml.Node | None, step: str | int) -> tuple[yaml.Node, int] | None:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if key.value == str(step):
                return value, key.start_mark.line + 1
    if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
        child = node.value[step]
        return child, child.start_mark.line + 1
    return None


def _not_yaml(name: str, what: str, line: int | None = None) -> TandemError:
    return refusal("problem.not_yaml", f"{name} {what}", file=name, line=line)


def _refuse_too_large(text: str, name: str) -> None:
    """Counts values and depth as they are read, before anything is built of them: building what 5 MB can hold
    takes minutes. Each value has at most one key."""
    nodes = depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.NodeEvent):
            nodes += 1
            depth += isinstance(event, yaml.CollectionStartEvent)
        if nodes > 2 * MAX_VALUES or depth > MAX_DEPTH:
            line = event.start_mark.line + 1 if event.start_mark else None
            raise _not_yaml(name, _TOO_DEEPLY_NESTED if depth > MAX_DEPTH else _TOO_MANY_VALUES, line)


def _refuse_what_is_not_plain(root: yaml.Node, name: str) -> None:
    """Only text, numbers, lists and mappings by text; no loops, and no more than is sensible when aliases are
    written out.
    """
    sizes: dict[int, int] = {}
    open_nodes: set[int] = set()

    def size(node: yaml.Node, depth: int) -> int:
        line = node.start_mark.line + 1
        if id(node) in open_nodes:
            raise _not_yaml(name, "has an alias that contains itself; write the values out", line)
        if depth > MAX_DEPTH:
            raise _not_yaml(name, _TOO_DEEPLY_NESTED, line)
        if node.tag not in PLAIN_TAGS:
            raise _not_yaml(name, f"has a value with the tag {node.tag!r}; write plain values", line)
        if isinstance(node, yaml.ScalarNode):
            if any("\ud800" <= letter <= "\udfff" for letter in node.value):
                raise _not_yaml(name, "has half a character (a lone surrogate); remove it", line)
            return 1
        if id(node) in sizes:
            return sizes[id(node)]
        children = node.value
        if isinstance(node, yaml.MappingNode):
            for key, _ in node.value:
                if key.tag not in ("tag:yaml.org,2002:str", "tag:yaml.org,2002:merge"):
                    what = f"has the key {key.value!r}, which is not text; write it as a name"
                    raise _not_yaml(
                        name,
                        what
                        if isinstance(key, yaml.ScalarNode)
                        else "has a key that is not text; write a name",
                        key.start_mark.line + 1,
                    )
            children = [value for _, value in node.value]
        open_nodes.add(id(node))
        total = 1 + sum(size(child, depth + 1) for child in children)
        open_nodes.remove(id(node))
        if total > MAX_VALUES:
            raise _not_yaml(name, _TOO_MANY_VALUES, line)
        sizes[id(node)] = total
        return total

    size(root, 0)


def _refuse_repeated(node: yaml.Node, name: str) -> None:
    """YAML lets a later key overwrite an earlier one in silence; a problem file may not."""
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
                    what = f"key '{key.value}' stands twice in one mapping; keep one"
                    raise refusal(
                        "problem.duplicate_name",
                        what,
                        file=name,
                        line=key.start_mark.line + 1,
                        field=str(key.value),
                    )
                seen.add(key.value)
                stack.append(value)
        elif isinstance(current, yaml.SequenceNode):
            stack.extend(current.value)


Far = Annotated[float, Field(ge=-100_000, le=100_000)]
"""A coordinate [mm]: a cell is not larger than 100 m."""
Angle = Annotated[float, Field(ge=-720, le=720)]
"""An angle [deg]."""
Vector = tuple[Far, Far, Far]
Positive = Annotated[float, Field(ge=0.01, le=100_000)]
"""A length [mm] of a body."""
Fraction = Annotated[float, Field(ge=0, le=1)]
Scale = Annotated[float, Field(gt=0, le=100_000)]
Unit = Literal["mm", "cm", "m", "in", "ft"]


def _united(unit: Unit | None, read: ValidationInfo) -> Unit | None:
    """The unit of the ``file`` above it, which may be left out where files of its kind state their own."""
    from planner.geometry.mesh_files import UNIT_SUFFIXES  # numpy, which most files that are read do not want

    file = read.data.get("file")
    if unit is None and file is not None and not file.lower().endswith(UNIT_SUFFIXES):
        raise ValueError("is required, as unit: mm; only GLB and 3MF files state their own")
    return unit


FileUnit = Annotated[
    Unit | None,
    AfterValidator(_united),
    Field(description="of its lengths; GLB and 3MF files state their own", validate_default=True),
]
"""Of files that may state their unit; where one does, the problem need not."""
Name = Annotated[
    str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,23}$", description="letter first, at most 24 characters")
]
FileName = Annotated[str, Field(min_length=1, max_length=1000)]


class Strict(BaseModel):
    """Base of every schema: unknown keys and non-finite numbers are refused, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


_Schema = TypeVar("_Schema", bound=Strict)


def read_as(model: type[_Schema], path: Path, code: str) -> _Schema:
    """A file as a value of its schema. Raises `TandemError`: ``code`` for every wrong field, with its line,
    and what `read` raises."""
    document = read(path)

    def wrong(what: str, got: object, path_in_file: tuple[str | int, ...]) -> Issue:
        return Issue(
            code,
            f"{what}; got {got!r:.80}",
            file=str(document.path),
            line=document.line(path_in_file),
            field=".".join(map(str, path_in_file)),
            hint="correct it, in the units of the field's name",
        )

    try:
        # as JSON, because its strict rules take a list for a tuple but no text for a number
        return model.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        faults = [wrong(one["msg"], one.get("input"), one["loc"]) for one in error.errors()]
        raise TandemError(faults) from error


def _word_or_mapping(value: object) -> str:
    """Which alternative a value is meant to be, so that its faults are told of that one alone."""
    return "mapping" if isinstance(value, dict | list | tuple | BaseModel) else "word"


Choice = Discriminator(_word_or_mapping)
