"""Plans: joint paths on one clock, with what programs and reports need; saved and loaded whole.

``plan.npz`` holds the arrays, ``plan.json`` everything else. Plain JSON arrays are tuples;
``{"$list": [...]}`` is a list, ``{"$array": key}`` an array of ``plan.npz``, ``{"$type": name,
...}`` one of the value classes that a plan holds, ``{"$float": "nan"}`` a number that JSON lacks
and ``{"$map": [[key, value], ...]}`` a mapping whose keys are not plain strings. Segments stand as
their labels, files (``{"$file": name}``) as their names, for a result's folder carries them.
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
from planner.files import write_whole
from planner.geometry.arrays import FloatArray, IntArray
from planner.issues import Issue, TandemError, refusal
from planner.runtime import plugins
from planner.runtime.plugins import Process
from planner.targets import Targets
from planner.tooling import Cutter


@dataclasses.dataclass(frozen=True)
class OperationPlan:
    """The motion of one operation.

    ``targets`` include the transit moves that motion added. ``q`` {arm: (N, 6)} serial joint angles [rad],
    ``values`` (N, F) of the freedoms, ``time`` (N,) [s] from the first target. ``entry`` and ``exit`` {arm:
    (M, 6)} are joint waypoints from home to the first target and from the last one back home; arms run them
    one after the other in the order ``order`` (entry) and its reverse (exit), each with the others standing
    still, but for those that ``together`` names ("entry", "exit"): there all arms go at once, in as many
    synchronised moves. ``metrics``: figures by name (costs, margins, clearances, stage times), for reports.
    ``commanded`` {arm: (N, 6)} [rad] are the joints that controllers are sent to, of arms whose sag is made
    up for: where these stand then is ``q``.
    """

    name: str
    targets: Targets = dataclasses.field(repr=False)
    q: Mapping[str, FloatArray] = dataclasses.field(repr=False)
    values: FloatArray = dataclasses.field(repr=False)
    time: FloatArray = dataclasses.field(repr=False)
    entry: Mapping[str, FloatArray] = dataclasses.field(repr=False)
    exit: Mapping[str, FloatArray] = dataclasses.field(repr=False)
    order: tuple[str, ...]
    metrics: Mapping[str, Any] = dataclasses.field(repr=False)
    issues: tuple[Issue, ...] = ()
    together: tuple[str, ...] = ()
    commanded: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict, repr=False)


@dataclasses.dataclass(frozen=True)
class Frame:
    """Where the arms are at ``time`` [s] of a plan: on the way to target ``target`` of the operation of that
    name; ``q`` {arm: (6,)} [rad] of the arms that take part in it."""

    time: float
    operation: str
    target: int
    segment: Segment
    q: Mapping[str, FloatArray]


@dataclasses.dataclass(frozen=True)
class Samples:
    """A plan at K equal steps of ``time`` (K,) [s]: index of the ``operation`` (K,), index of the ``target``
    (K,) that the arms move to, and ``q`` {arm: (K, 6)} [rad], NaN while an arm takes no part."""

    time: FloatArray
    operation: IntArray
    target: IntArray
    q: Mapping[str, FloatArray]


MOST_SAMPLES: Final = 10_000_000
"""Samples of one plan at most: more are a slip of the unit of the step."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """Plans of all operations of a problem. ``places``: the stock's pose (4, 4) in the world in each setup,
    for a held block the pose about which its holder moves it; ``bases`` {arm: (4, 4)} are in the world, of
    arms that stand on no track; ``stations`` as :attr:`planner.problem.Problem.stations` has them.
    """

    problem_name: str
    digest: str
    versions: Mapping[str, str] = dataclasses.field(repr=False)
    places: tuple[FloatArray, ...]
    bases: Mapping[str, FloatArray]
    operations: tuple[OperationPlan, ...]
    metrics: Mapping[str, Any] = dataclasses.field(repr=False)
    issues: tuple[Issue, ...] = ()
    stations: Mapping[int, Mapping[str, float]] = dataclasses.field(default_factory=dict)

    @property
    def stock_pose(self) -> FloatArray:
        """The stock's pose (4, 4) in the first setup."""
        return self.places[0]

    @property
    def duration(self) -> float:
        """Time [s] of all operations, one after the other, each from its first target to its last; the ways
        from and to home, setups and waits have no clock in a plan."""
        return float(sum(operation.time[-1] - operation.time[0] for operation in self.operations))

    def frame(self, t: float) -> Frame:
        """Where the arms are at time ``t`` [s], from 0 to :attr:`duration`.

        Joint angles are taken linearly between two targets, as the replay shows them; what the programs' text
        makes of them is in the proof. Raises ``ValueError`` for times outside.
        """
        if not 0.0 <= t <= self.duration or not self.operations:
            raise ValueError(f"t is {t:g} s, the plan goes from 0 to {self.duration:g} s")
        at = self._at(np.array([t]))
        own = self.operations[at.operation[0]]
        q = {arm: at.q[arm][0] for arm in own.q}
        target = int(at.target[0])
        return Frame(float(t), own.name, target, own.targets.segment[target], q)

    def sample(self, dt: float) -> Samples:
        """The whole plan every ``dt`` [s], its end included; else as :meth:`frame`. Raises ``ValueError`` for
        a step that is not above 0, or of which there would be over :data:`MOST_SAMPLES`."""
        if not (dt > 0.0 and self.duration / dt < MOST_SAMPLES):
            least = self.duration / MOST_SAMPLES
            raise ValueError(f"dt is {dt:g} s, a step is above {max(least, 0.0):.3g} s")
        steps = np.arange(0.0, self.duration, dt)
        return self._at(np.append(steps, self.duration) if self.operations else steps)

    def _at(self, time: FloatArray) -> Samples:
        """The plan at times (K,) [s], ascending, within its duration."""
        lengths = [operation.time[-1] - operation.time[0] for operation in self.operations]
        ends = np.cumsum(lengths)
        operation = np.minimum(np.searchsorted(ends, time, side="left"), max(len(lengths) - 1, 0))
        target = np.zeros(len(time), dtype=np.int64)
        joints = {arm: path.shape[1] for own in self.operations for arm, path in own.q.items()}
        q = {arm: np.full((len(time), count), np.nan) for arm, count in joints.items()}
        for number, own in enumerate(self.operations):
            here = operation == number
            clock = time[here] - (ends[number] - lengths[number]) + own.time[0]
            target[here] = np.clip(np.searchsorted(own.time, clock, side="left"), 0, len(own.time) - 1)
            for arm, path in own.q.items():
                q[arm][here] = np.stack([np.interp(clock, own.time, joint) for joint in path.T], axis=1)
        return Samples(time, operation, target, q)


FORMAT: Final = "tandem-plan"
"""Name of the format at the head of a plan file."""
SCHEMA: Final = 1
"""Version of the format; another one is refused."""
ARRAYS_FILE: Final = "plan.npz"
"""File of a plan with its arrays."""
DATA_FILE: Final = "plan.json"
"""File of a plan with all else."""


def _held(kinds: Iterable[Any], known: dict[str, type]) -> dict[str, type]:
    """All dataclasses among types and in the fields of these, by name, but for what is written otherwise."""
    for kind in kinds:
        if dataclasses.is_dataclass(kind) and isinstance(kind, type) and kind not in (Issue, Segment):
            if known.get(kind.__name__) is not kind:
                known[kind.__name__] = kind
                _held(get_type_hints(kind).values(), known)
        else:
            _held(get_args(kind), known)
    return known


def _values() -> dict[str, type]:
    """Return the classes of values that plans hold, by name.

    Claims are those of all installed processes. Cutters are in exhibits, whose fields have no types.
    """
    plugins.loadable(Process, "claims", tuple)  # imports them
    return _values_with(claim.kinds())


@functools.cache
def _values_with(kinds: tuple[type[claim.Claim], ...]) -> dict[str, type]:
    return _held((Plan, Cutter, *kinds), {})


_SEGMENTS: Final = {"segment", "segments"}
"""Fields of those classes that hold segments."""
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
"""What decoding a damaged file may raise."""

Arrays = dict[str, NDArray[Any]]


def save(plan: Plan, folder: str | os.PathLike[str]) -> None:
    """Writes ``plan.npz`` and ``plan.json`` into ``folder``, which is made if missing; see :func:`dump`."""
    for name, content in dump(plan).items():
        write_whole(Path(folder) / name, content)


def dump(plan: Plan) -> dict[str, bytes]:
    """The content of ``plan.npz`` and ``plan.json``; the same plan gives the same bytes, so the wall-clock
    times of the planning (``stages`` in the metrics) are left out.

    ``plan.json`` comes last and carries the hash of ``plan.npz``, so a pair torn apart by a kill is found.
    Raises :class:`TandemError` (``plan.not_saveable``) for a value that is neither an array nor plain data.
    """
    arrays: Arrays = {}
    tree = _encode(_timeless(plan), "", arrays)
    packed = _pack(arrays)
    header = {"format": FORMAT, "schema": SCHEMA, "arrays": hashlib.sha256(packed).hexdigest(), "plan": tree}
    text = json.dumps(header, indent=1, ensure_ascii=False, allow_nan=False)
    return {ARRAYS_FILE: packed, DATA_FILE: text.encode()}


def load(folder: str | os.PathLike[str]) -> Plan:
    """The plan that :func:`save` wrote into ``folder``.

    Raises :class:`TandemError`: ``plan.missing_file``, ``plan.schema`` (made by another format or version) or
    ``plan.damaged``.
    """
    source = Path(folder)
    header = _header(source / DATA_FILE)
    packed = _bytes(source / ARRAYS_FILE)
    if hashlib.sha256(packed).hexdigest() != header.get("arrays"):
        raise _damaged(source / ARRAYS_FILE, "its hash is not the one that plan.json states")
    try:
        plan = _decode(header["plan"], _unpack(packed))
    except _DAMAGED_FILE_ERRORS as error:
        raise _damaged(source / DATA_FILE, f"{type(error).__name__}: {error}") from error
    if not isinstance(plan, Plan):
        raise _damaged(source / DATA_FILE, f"it holds a {type(plan).__name__}, not a plan")
    return plan


def _timeless(plan: Plan) -> Plan:
    def kept(metrics: Mapping[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in metrics.items() if name != "stages"}

    operations = tuple(dataclasses.replace(op, metrics=kept(op.metrics)) for op in plan.operations)
    return dataclasses.replace(plan, operations=operations, metrics=kept(plan.metrics))


def _encode(value: Any, key: str, arrays: Arrays) -> Any:
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise _not_saveable(key, "an array of Python objects")
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
    if dataclasses.is_dataclass(value) and type(value) in _values().values():
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
        return {"$type": type(value).__name__, **_encode_items(fields, key, arrays)}
    if isinstance(value, Mapping):
        if all(isinstance(k, str) and not k.startswith("$") for k in value):
            return _encode_items(value, key, arrays)
        rows = [
            [_encode(k, f"{key}/{i}k", arrays), _encode(v, f"{key}/{i}", arrays)]
            for i, (k, v) in enumerate(value.items())
        ]
        return {"$map": rows}
    if isinstance(value, tuple | list):
        items = [_encode(item, f"{key}/{i}", arrays) for i, item in enumerate(value)]
        return items if isinstance(value, tuple) else {"$list": items}
    raise _not_saveable(key, f"a {type(value).__name__}")


def _encode_items(items: Mapping[str, Any], key: str, arrays: Arrays) -> dict[str, Any]:
    def path(name: str) -> str:
        return f"{key}/{name.replace('~', '~0').replace('/', '~1')}"

    return {k: _encode(v, path(k), arrays) for k, v in items.items()}


def _decode(value: Any, arrays: Arrays) -> Any:
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
    for name in _SEGMENTS & set(fields):
        own = fields[name]
        if own is not None:
            fields[name] = tuple(map(Segment.read, own)) if isinstance(own, tuple) else Segment.read(own)
    return _values()[value["$type"]](**fields)


def _pack(arrays: Arrays) -> bytes:
    """The bytes of an npz file with fixed dates, so that equal arrays give equal bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for key, array in arrays.items():
            with archive.open(zipfile.ZipInfo(f"{key[1:]}.npy"), "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)
    return stream.getvalue()


def _unpack(packed: bytes) -> Arrays:
    with np.load(io.BytesIO(packed), allow_pickle=False) as archive:
        return {f"/{key}": archive[key] for key in archive.files}


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise refusal(
            "plan.missing_file",
            f"{path.name} cannot be read: {error.strerror}; "
            f"a plan is {DATA_FILE} and {ARRAYS_FILE} in one folder",
            file=str(path),
            hint="give the folder that `tandem plan -o` wrote",
        ) from error


def _header(path: Path) -> dict[str, Any]:
    try:
        header = json.loads(_bytes(path))
    except (ValueError, RecursionError) as error:
        raise _damaged(path, f"not JSON: {error}") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise _foreign(path, f"{path.name} is not a plan of Tandem (no format {FORMAT!r})")
    if header.get("schema") != SCHEMA:
        raise _foreign(
            path, f"{path.name} has schema version {header.get('schema')!r}; this version reads {SCHEMA}"
        )
    return header


def _damaged(path: Path, why: str) -> TandemError:
    return refusal(
        "plan.damaged", f"{path.name} is damaged: {why}", file=str(path), hint="plan the problem again"
    )


def _foreign(path: Path, message: str) -> TandemError:
    return refusal("plan.schema", message, file=str(path), hint="plan the problem again")


def _not_saveable(key: str, what: str) -> TandemError:
    return refusal(
        "plan.not_saveable",
        f"the plan's value {key[1:] or 'itself'} is {what}; a plan holds arrays, tuples, lists, "
        "mappings, text, numbers and Tandem's own values",
        field=key[1:],
    )
