"""Facts: what rules share, built once in a proof, on first use.

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
        name: Name of the fact, one of its own.
        build: Builds the fact from the context.
        sent: Whether the fact goes along when the context is sent to another process. If not, it is built
            anew there if a rule needs it.
        lasting: Whether the fact stays the same when the context is replaced by one with less room.
    """

    name: str
    build: Callable[[Subject], T_co]
    sent: bool = False
    lasting: bool = False


class Facts(Generic[Subject]):
    """The facts of one context. Facts that are built from one another must not form a circle."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}
        self._facts: dict[str, Fact[Subject, Any]] = {}

    def get(self, fact: Fact[Subject, T], subject: Subject) -> T:
        """Return a fact. Build it if this is its first use."""
        if fact.name not in self._values:
            self.put(fact, fact.build(subject))
        value: T = self._values[fact.name]
        return value

    def put(self, fact: Fact[Subject, T], value: T) -> None:
        """State a fact that was built elsewhere."""
        self._values[fact.name], self._facts[fact.name] = value, fact

    def release(self, fact: Fact[Subject, Any]) -> None:
        """Drop a fact, so that its memory becomes free."""
        self._values.pop(fact.name, None)

    def lasting(self) -> "Facts[Subject]":
        """Return only the facts that are marked as ``lasting``."""
        out: Facts[Subject] = Facts()
        for name, fact in self._facts.items():
            if fact.lasting and name in self._values:
                out.put(fact, self._values[name])
        return out

    def __contains__(self, fact: Fact[Subject, Any]) -> bool:
        return fact.name in self._values

    def __getstate__(self) -> dict[str, Any]:
        """Send only facts that are marked as ``sent``. Functions that build facts do not go along."""
        sent = (name for name, fact in self._facts.items() if fact.sent and name in self._values)
        return {"_values": {name: self._values[name] for name in sent}, "_facts": {}}
