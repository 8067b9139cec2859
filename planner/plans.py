"""Plans: joint paths on one clock, with the data that programs and reports need, and their files.

``plan.npz`` holds the arrays, ``plan.json`` everything else, in this encoding:

- a plain JSON array is a tuple, ``{"$list": [...]}`` a list;
- ``{"$array": key}`` is an array of ``plan.npz``;
- ``{"$type": name, ...}`` is one of the value classes that a plan holds;
- ``{"$float": "nan"}`` is a number that JSON lacks;
- ``{"$map": [[key, value], ...]}`` is a mapping whose keys are not plain strings;
- a segment is its label;
- ``{"$file": name}`` is the name of a file that the result folder carries.

Nothing is pickled.
"""

import dataclasses
import functools
import hashlib
import io
import json
import math
import os
import zipfile
from collections.abc import Iterable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any, Final, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from planner.claims import claim
from planner.claims.segments import Segment
from planner.files import write_atomic
from planner.geometry.arrays import FloatArray, IntArray
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.runtime import plugins
from planner.runtime.plugins import Process
from planner.targets import Targets
from planner.tooling import Cutter


@dataclasses.dataclass(frozen=True)
class OperationPlan:
    """Motion of one operation.

    Attributes:
        name: Name of the operation.
        targets: Targets, including those of the links that motion added; N targets.
        q: {arm: (N, 6)} serial joint angles [rad].
        values: Values of the freedoms (N, F).
        time: Time from the first target (N,) [s].
        approach: {arm: (M, 6)} joint waypoints from home to the first target [rad].
        retreat: {arm: (M, 6)} joint waypoints from the last target to home [rad].
        arm_order: Order in which arms run their approach, one after the other while the others stand still.
            The retreat uses the reverse order.
        metrics: Values by name (costs, margins, clearances, stage times), for reports.
        issues: Issues of the motion.
        synchronised: "entry" and "exit" for an approach or retreat in which all arms move at once, in as many
            synchronised moves.
        commanded: {arm: (N, 6)} [rad] joint angles that the program commands, for arms with sag compensation.
            The sagged arm is then at ``q``.
    """

    name: str
    targets: Targets = dataclasses.field(repr=False)
    q: Mapping[str, FloatArray] = dataclasses.field(repr=False)
    values: FloatArray = dataclasses.field(repr=False)
    time: FloatArray = dataclasses.field(repr=False)
    approach: Mapping[str, FloatArray] = dataclasses.field(repr=False)
    retreat: Mapping[str, FloatArray] = dataclasses.field(repr=False)
    arm_order: tuple[str, ...]
    metrics: Mapping[str, Any] = dataclasses.field(repr=False)
    issues: tuple[Issue, ...] = ()
    synchronised: tuple[str, ...] = ()
    commanded: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict, repr=False)


@dataclasses.dataclass(frozen=True)
class PlanFrame:
    """State of the arms at one time of a plan.

    Attributes:
        time: Time [s].
        operation: Name of the operation.
        target: Index of the target that the arms move to.
        segment: Segment of that move.
        q: {arm: (6,)} joint angles [rad] of the arms that take part.
    """

    time: float
    operation: str
    target: int
    segment: Segment
    q: Mapping[str, FloatArray]


@dataclasses.dataclass(frozen=True)
class PlanSamples:
    """A plan at K equal time steps.

    Attributes:
        time: Time (K,) [s].
        operation: Index of the operation (K,).
        target: Index of the target that the arms move to (K,).
        q: {arm: (K, 6)} joint angles [rad], NaN while an arm takes no part.
    """

    time: FloatArray
    operation: IntArray
    target: IntArray
    q: Mapping[str, FloatArray]


MAX_SAMPLES: Final = 10_000_000
"""Maximum number of samples of one plan. More indicate a wrong unit of the time step."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """Plans of all operations of a problem.

    Attributes:
        problem_name: Name of the problem.
        digest: SHA-256 of the problem.
        versions: Versions of the packages that the plan depends on.
        stock_poses: Pose (4, 4) of the stock in the world in each setup. For a held stock: the pose about
            which its holder moves it.
        bases: {arm: (4, 4)} base poses in the world, of arms without linear axes.
        operations: Plans of the operations.
        metrics: Values by name, for reports.
        issues: Issues of planning.
        stations: Values of the external axes, as :attr:`planner.problem.Problem.stations`.
    """

    problem_name: str
    digest: str
    versions: Mapping[str, str] = dataclasses.field(repr=False)
    stock_poses: tuple[FloatArray, ...]
    bases: Mapping[str, FloatArray]
    operations: tuple[OperationPlan, ...]
    metrics: Mapping[str, Any] = dataclasses.field(repr=False)
    issues: tuple[Issue, ...] = ()
    stations: Mapping[int, Mapping[str, float]] = dataclasses.field(default_factory=dict)

    @property
    def stock_pose(self) -> FloatArray:
        """Pose (4, 4) of the stock in the first setup."""
        return self.stock_poses[0]

    @property
    def duration(self) -> float:
        """Total time of all operations [s], each from its first target to its last.

        Approaches, retreats, setups and waits have no clock in a plan and are not included.
        """
        return float(sum(operation.time[-1] - operation.time[0] for operation in self.operations))

    def frame(self, t: float) -> PlanFrame:
        """Return the state of the arms at a time.

        Joint angles are interpolated linearly between targets, as in the replay. The motion that robots
        execute follows from the text of the programs, and is examined by the proof.

        Args:
            t: Time [s], from 0 to :attr:`duration`.

        Raises:
            ValueError: If ``t`` is outside.
        """
        if not 0.0 <= t <= self.duration or not self.operations:
            raise ValueError(f"t must be from 0 to {self.duration:g} s, got {t:g} s")
        sample = self._sample_times(np.array([t]))
        operation = self.operations[sample.operation[0]]
        q = {arm: sample.q[arm][0] for arm in operation.q}
        target = int(sample.target[0])
        return PlanFrame(float(t), operation.name, target, operation.targets.segment[target], q)

    def sample(self, dt: float) -> PlanSamples:
        """Sample the whole plan every ``dt`` [s], including its end, as :meth:`frame`.

        Raises:
            ValueError: If the step is not positive or gives more than :data:`MAX_SAMPLES` samples.
        """
        if not (dt > 0.0 and self.duration / dt < MAX_SAMPLES):
            min_step = self.duration / MAX_SAMPLES
            raise ValueError(f"dt must be above {max(min_step, 0.0):.3g} s, got {dt:g} s")
        steps = np.arange(0.0, self.duration, dt)
        return self._sample_times(np.append(steps, self.duration) if self.operations else steps)

    def _sample_times(self, time: FloatArray) -> PlanSamples:
        """Sample the plan at times (K,) [s], ascending, within its duration.

        Joint angles are interpolated linearly between targets. They are NaN for an arm that takes no part in
        the operation at that time. The target of a sample is the first one at or after its time.
        """
        # operations follow one another without a gap on the clock of the plan
        durations = [operation.time[-1] - operation.time[0] for operation in self.operations]
        ends = np.cumsum(durations)
        operation = np.minimum(np.searchsorted(ends, time, side="left"), max(len(durations) - 1, 0))
        target = np.zeros(len(time), dtype=np.int64)
        joint_counts = {
            arm: path.shape[1] for operation_plan in self.operations for arm, path in operation_plan.q.items()
        }
        q = {arm: np.full((len(time), count), np.nan) for arm, count in joint_counts.items()}
        for index, operation_plan in enumerate(self.operations):
            in_operation = operation == index
            start = ends[index] - durations[index]
            operation_time = time[in_operation] - start + operation_plan.time[0]
            target[in_operation] = np.clip(
                np.searchsorted(operation_plan.time, operation_time, side="left"),
                0,
                len(operation_plan.time) - 1,
            )
            for arm, path in operation_plan.q.items():
                q[arm][in_operation] = np.stack(
                    [np.interp(operation_time, operation_plan.time, joint) for joint in path.T], axis=1
                )
        return PlanSamples(time, operation, target, q)


FORMAT: Final = "tandem-plan"
"""Name of the format at the head of a plan file."""
SCHEMA: Final = 2
"""Version of the format. Files of any other version are refused."""
ARRAYS_FILE: Final = "plan.npz"
"""Name of the file with the arrays of a plan."""
DATA_FILE: Final = "plan.json"
"""Name of the file with everything else of a plan."""


def _collect_dataclasses(kinds: Iterable[Any], classes: dict[str, type]) -> dict[str, type]:
    """Add the dataclasses among type hints, and those in the types of their fields, to ``classes`` by name.

    Issues and segments are left out, because they have an encoding of their own. The result is ``classes``.
    """
    for kind in kinds:
        if dataclasses.is_dataclass(kind) and isinstance(kind, type) and kind not in (Issue, Segment):
            if classes.get(kind.__name__) is not kind:
                classes[kind.__name__] = kind
                _collect_dataclasses(get_type_hints(kind).values(), classes)
        else:
            _collect_dataclasses(get_args(kind), classes)
    return classes


def _value_classes() -> dict[str, type]:
    """Return the classes of values that plans hold, by name.

    These are the classes in the fields of a plan, the claims of all installed processes, and cutters, which
    occur in exhibits, whose types no field states.
    """
    plugins.loadable(Process, "claims", tuple)  # imports the modules that register the kinds of claims
    return _value_classes_with(claim.kinds())


@functools.cache
def _value_classes_with(kinds: tuple[type[claim.Claim], ...]) -> dict[str, type]:
    """Return the classes of values that plans with these kinds of claims hold, by name."""
    return _collect_dataclasses((Plan, Cutter, *kinds), {})


_SEGMENT_FIELDS: Final = {"segment", "segments"}
"""Fields of the value classes that hold segments."""
_DAMAGED_FILE_ERRORS: Final = (
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    RecursionError,
    EOFError,
    OSError,
    zipfile.BadZipFile,
)
"""Errors that the decoding of a damaged file may raise."""

Arrays = dict[str, NDArray[Any]]
"""Arrays of a plan by their keys, which are their paths in the plan, such as "/operations/0/time"."""


def save(plan: Plan, folder: str | os.PathLike[str]) -> None:
    """Write ``plan.npz`` and ``plan.json`` into ``folder``, which is created if missing; see :func:`dump`."""
    for name, content in dump(plan).items():
        write_atomic(Path(folder) / name, content)


def dump(plan: Plan) -> dict[str, bytes]:
    """Return the content of ``plan.npz`` and ``plan.json``, by name.

    Equal plans give equal bytes. For this the wall-clock times of planning (``stages`` in the metrics) are
    left out. ``plan.json`` is last and carries the hash of ``plan.npz``. So :func:`load` detects two files of
    different plans, as a killed run may leave them.

    Raises:
        TandemError: ``plan.not_saveable`` for a value that is neither an array nor plain data.
    """
    arrays: Arrays = {}
    tree = _encode(_without_stage_times(plan), "", arrays)
    packed = _pack(arrays)
    header = {"format": FORMAT, "schema": SCHEMA, "arrays": hashlib.sha256(packed).hexdigest(), "plan": tree}
    text = json.dumps(header, indent=1, ensure_ascii=False, allow_nan=False)
    return {ARRAYS_FILE: packed, DATA_FILE: text.encode()}


def load(folder: str | os.PathLike[str]) -> Plan:
    """Load the plan that :func:`save` wrote into ``folder``.

    Raises:
        TandemError: ``plan.missing_file``, ``plan.schema`` (another format or version) or ``plan.damaged``.
    """
    source = Path(folder)
    header = _read_header(source / DATA_FILE)
    packed = _read_bytes(source / ARRAYS_FILE)
    if hashlib.sha256(packed).hexdigest() != header.get("arrays"):
        raise _damaged_error(source / ARRAYS_FILE, "its hash is not the one that plan.json states")
    try:
        plan = _decode(header["plan"], _unpack(packed))
    except _DAMAGED_FILE_ERRORS as error:
        raise _damaged_error(source / DATA_FILE, f"{type(error).__name__}: {error}") from error
    if not isinstance(plan, Plan):
        raise _damaged_error(source / DATA_FILE, f"it holds a {type(plan).__name__}, not a plan")
    return plan


def _without_stage_times(plan: Plan) -> Plan:
    """Return the plan without the wall-clock times of its stages, which differ from run to run."""

    def without_stages(metrics: Mapping[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in metrics.items() if name != "stages"}

    operations = tuple(dataclasses.replace(op, metrics=without_stages(op.metrics)) for op in plan.operations)
    return dataclasses.replace(plan, operations=operations, metrics=without_stages(plan.metrics))


def _encode(value: Any, key: str, arrays: Arrays) -> Any:
    """Return a value as plain data for JSON, in the encoding of this module.

    Args:
        value: Value to encode.
        key: Path of the value in the plan, with "/" before each name or index.
        arrays: Arrays of the plan, to which those in the value are added.

    Raises:
        TandemError: ``plan.not_saveable`` for a value without an encoding.
    """
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise _not_saveable_error(key, "an array of Python objects")
        arrays[key] = value
        return {"$array": key}
    if isinstance(value, np.generic):
        return _encode(value.item(), key, arrays)
    if isinstance(value, Enum):
        return _encode(value.value, key, arrays)
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Path):
        return {"$file": value.name}
    if isinstance(value, Segment):
        return str(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else {"$float": repr(value)}
    if isinstance(value, Issue):
        return {"$type": "Issue", **{k: _encode(v, f"{key}/{k}", arrays) for k, v in value.to_dict().items()}}
    if dataclasses.is_dataclass(value) and type(value) in _value_classes().values():
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
        return {"$type": type(value).__name__, **_encode_items(fields, key, arrays)}
    if isinstance(value, Mapping):
        if all(isinstance(k, str) and not k.startswith("$") for k in value):
            return _encode_items(value, key, arrays)
        pairs = [
            [_encode(k, f"{key}/{i}k", arrays), _encode(v, f"{key}/{i}", arrays)]
            for i, (k, v) in enumerate(value.items())
        ]
        return {"$map": pairs}
    if isinstance(value, tuple | list):
        items = [_encode(item, f"{key}/{i}", arrays) for i, item in enumerate(value)]
        return items if isinstance(value, tuple) else {"$list": items}
    raise _not_saveable_error(key, f"a {type(value).__name__}")


def _encode_items(items: Mapping[str, Any], key: str, arrays: Arrays) -> dict[str, Any]:
    """Return named values as plain data, each with its name at the end of its path.

    In paths, "~" and "/" of names are escaped as in JSON pointers.
    """

    def path(name: str) -> str:
        return f"{key}/{name.replace('~', '~0').replace('/', '~1')}"

    return {k: _encode(v, path(k), arrays) for k, v in items.items()}


def _decode(value: Any, arrays: Arrays) -> Any:
    """Return the value that :func:`_encode` encoded, with its arrays from ``arrays``.

    Raises one of :data:`_DAMAGED_FILE_ERRORS` for data in another form.
    """
    if isinstance(value, list):
        return tuple(_decode(item, arrays) for item in value)
    if not isinstance(value, dict):
        return value
    if "$array" in value:
        return arrays[value["$array"]]
    if "$float" in value:
        return float(value["$float"])
    if "$file" in value:
        return Path(value["$file"])
    if "$list" in value:
        return [_decode(item, arrays) for item in value["$list"]]
    if "$map" in value:
        return {_decode(k, arrays): _decode(v, arrays) for k, v in value["$map"]}
    fields = {k: _decode(v, arrays) for k, v in value.items() if k != "$type"}
    if "$type" not in value:
        return fields
    if value["$type"] == "Issue":
        return Issue.from_dict(fields)
    for name in _SEGMENT_FIELDS & set(fields):
        labels = fields[name]
        if labels is not None:
            fields[name] = (
                tuple(map(Segment.read, labels)) if isinstance(labels, tuple) else Segment.read(labels)
            )
    return _value_classes()[value["$type"]](**fields)


def _pack(arrays: Arrays) -> bytes:
    """Return the bytes of an npz file. Its dates are fixed, so that equal arrays give equal bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for key, array in arrays.items():
            name = f"{key[1:]}.npy"  # without the slash at the start, as names in an archive are relative
            with archive.open(zipfile.ZipInfo(name), "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)
    return stream.getvalue()


def _unpack(packed: bytes) -> Arrays:
    """Return the arrays that :func:`_pack` packed."""
    with np.load(io.BytesIO(packed), allow_pickle=False) as archive:
        return {f"/{key}": archive[key] for key in archive.files}


def _read_bytes(path: Path) -> bytes:
    """Return the content of a file of a plan.

    Raises:
        TandemError: ``plan.missing_file`` if it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise issue_error(
            "plan.missing_file",
            f"{path.name} cannot be read: {error.strerror}; "
            f"a plan is {DATA_FILE} and {ARRAYS_FILE} in one folder",
            file=str(path),
            hint="give the folder that `tandem plan -o` wrote",
        ) from error


def _read_header(path: Path) -> dict[str, Any]:
    """Return the content of ``plan.json``, whose format and version are checked.

    Raises:
        TandemError: ``plan.missing_file``, ``plan.damaged`` (not JSON) or ``plan.schema``.
    """
    try:
        header = json.loads(_read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise _damaged_error(path, f"not JSON: {error}") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise _schema_error(path, f"{path.name} is not a plan of Tandem (no format {FORMAT!r})")
    if header.get("schema") != SCHEMA:
        raise _schema_error(
            path, f"{path.name} has schema version {header.get('schema')!r}; this version reads {SCHEMA}"
        )
    return header


def _damaged_error(path: Path, reason: str) -> TandemError:
    return issue_error(
        "plan.damaged", f"{path.name} is damaged: {reason}", file=str(path), hint="plan the problem again"
    )


def _schema_error(path: Path, message: str) -> TandemError:
    return issue_error("plan.schema", message, file=str(path), hint="plan the problem again")


def _not_saveable_error(key: str, kind: str) -> TandemError:
    """Return ``plan.not_saveable`` for a value of a kind at the path ``key`` of a plan."""
    return issue_error(
        "plan.not_saveable",
        format_message("plan.not_saveable", field=key[1:] or "itself", kind=kind),
        field=key[1:],
    )
