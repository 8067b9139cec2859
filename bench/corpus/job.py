"""A job of the corpus: a folder like a user's, and its expected result."""

from __future__ import annotations

import copy
import dataclasses
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

PROBLEM = "problem.yaml"
Data = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Job:
    """One job. ``codes`` are the issue codes that name the fault that the generator put in, any of them
    right; none: the job can be made. ``why``: the fault, or the argument that there is none."""

    name: str
    family: str
    seed: int
    files: Mapping[str, bytes]
    codes: frozenset[str]
    why: str

    @property
    def feasible(self) -> bool:
        return not self.codes

    def write(self, folder: Path) -> Path:
        """Write the job's files into a folder of its name; the path of the problem file."""
        own = folder / self.name
        own.mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            (own / name).write_bytes(content)
        return own / PROBLEM


class Draw:
    """Seeded choices, rounded as users round."""

    def __init__(self, family: str, index: int) -> None:
        self.seed = zlib.crc32(f"{family}/{index}".encode())
        self.random = np.random.default_rng(self.seed)
        self.index = index

    def number(self, low: float, high: float, digits: int = 1) -> float:
        """A number between two, rounded to ``digits``."""
        return round(float(self.random.uniform(low, high)), digits)

    def whole(self, low: int, high: int) -> int:
        """A whole number from ``low`` to ``high``, both included."""
        return int(self.random.integers(low, high + 1))

    def pick(self, choices: Sequence[Any]) -> Any:
        """One of some choices."""
        return copy.deepcopy(choices[int(self.random.integers(len(choices)))])

    def turn(self, choices: Sequence[Any]) -> Any:
        """The choices in turn, by the job's number: each of them comes up."""
        return copy.deepcopy(choices[self.index % len(choices)])

    def chance(self, probability: float) -> bool:
        return bool(self.random.random() < probability)


@dataclasses.dataclass
class Draft:
    """A job that is being made: its problem and cell as a file has them, its other files, and ``facts``
    about it that faults need."""

    problem: Data
    cell: Data
    files: dict[str, bytes] = dataclasses.field(default_factory=dict)
    facts: Data = dataclasses.field(default_factory=dict)
    why: str = ""

    @property
    def operation(self) -> Data:
        """The first operation."""
        first: Data = self.problem["operations"][0]
        return first


@dataclasses.dataclass(frozen=True)
class Fault:
    """One thing wrong: ``spoil`` changes a draft that was right; ``codes`` name the cause."""

    why: str
    codes: tuple[str, ...]
    spoil: Callable[[Draft, Draw], None]


def faulty(index: int) -> bool:
    """Whether the job of this number has a fault: every third one."""
    return index % 3 == 2


def make(name: str, index: int, base: Callable[[Draw], Draft], faults: Sequence[Fault]) -> Job:
    """One job of a family; those that are faulty have the faults in turn."""
    draw = Draw(name, index)
    draft = base(draw)
    codes: tuple[str, ...] = ()
    if faulty(index):
        fault = faults[(index // 3) % len(faults)]
        fault.spoil(draft, draw)
        codes, draft.why = fault.codes, fault.why
    return _job(f"{name}_{index:02d}", name, draw.seed, draft, codes)


def _job(name: str, kind: str, seed: int, draft: Draft, codes: tuple[str, ...]) -> Job:
    problem = {"tandem": 1, "name": name, "cell": "cell.yaml", **draft.problem}
    files = {PROBLEM: text(problem, f"# {draft.why}\n"), "cell.yaml": text(draft.cell), **draft.files}
    return Job(name, kind, seed, files, frozenset(codes), draft.why)


def text(data: Data, head: str = "") -> bytes:
    """A YAML file, as a user would write it."""
    return (head + yaml.safe_dump(plain(data), sort_keys=False, default_flow_style=None, width=110)).encode()


def plain(value: Any) -> Any:
    """Plain data with numbers as a user writes them: to four decimals, without NumPy's types."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.floating | float):
        return round(float(value), 4) + 0.0
    return int(value) if isinstance(value, np.integer) else value
