"""Facts: what rules share. Each is built once in a proof, on first use.

>>> TRACKS: Final = Fact("tracks", build_tracks)  # in a process: a function of the context
>>> tracks = context.get(TRACKS)  # in a rule: built once, typed
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Generic, TypeVar

Subject = TypeVar("Subject", contravariant=True)
T_co = TypeVar("T_co", covariant=True)
T = TypeVar("T")


@dataclasses.dataclass(frozen=True, eq=False)
class Fact(Generic[Subject, T_co]):
    """Something that follows from a proof's context.

    Attributes:
        name: Unique name of the fact.
        build: Builds the fact from the context.
        sent: Whether the fact is included when the context is sent to another process. If not, it is built
            again there if a rule needs it.
        persistent: Whether the fact stays valid when the context is replaced by one with smaller margins.
    """

    name: str
    build: Callable[[Subject], T_co]
    sent: bool = False
    persistent: bool = False


class Facts(Generic[Subject]):
    """The facts of one context. Facts must not depend on one another in a cycle."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}
        self._facts: dict[str, Fact[Subject, Any]] = {}

    def get(self, fact: Fact[Subject, T], subject: Subject) -> T:
        """Return a fact. It is built on first use."""
        if fact.name not in self._values:
            self.put(fact, fact.build(subject))
        value: T = self._values[fact.name]
        return value

    def put(self, fact: Fact[Subject, T], value: T) -> None:
        """Set a fact that was built elsewhere."""
        self._values[fact.name], self._facts[fact.name] = value, fact

    def release(self, fact: Fact[Subject, Any]) -> None:
        """Drop a fact to free its memory."""
        self._values.pop(fact.name, None)

    def persistent_facts(self) -> "Facts[Subject]":
        """Return only the facts that are marked as ``persistent``."""
        out: Facts[Subject] = Facts()
        for name, fact in self._facts.items():
            if fact.persistent and name in self._values:
                out.put(fact, self._values[name])
        return out

    def __contains__(self, fact: Fact[Subject, Any]) -> bool:
        return fact.name in self._values

    def __getstate__(self) -> dict[str, Any]:
        """Keep only facts that are marked as ``sent``. Functions that build facts are not included."""
        sent_names = (name for name, fact in self._facts.items() if fact.sent and name in self._values)
        return {"_values": {name: self._values[name] for name in sent_names}, "_facts": {}}
