"""Segments of a path: their kinds, phases and names."""

import dataclasses
import functools
import re
import unicodedata
from collections.abc import Iterable
from typing import Final, Literal

Phase = Literal["", "in", "out"]
PHASES: Final[tuple[Phase, ...]] = ("in", "", "out")
"""The way in to what a segment works on, the work itself, the way out: in the order in which they come."""
WORKING_KINDS: Final = frozenset({"cut", "form", "mill", "trim"})
"""Kinds of segments in which a tool's own edge works the stock, and may touch it."""
ON_ENDING: Final = "on"
"""Ends the label of a segment without a phase whose name ends as if it had one."""
_ENDING: Final = re.compile(rf"(.+)_(in|out|{ON_ENDING})", re.DOTALL)
"""Label of a segment with a phase, or with the mark that it has none."""


@dataclasses.dataclass(frozen=True, slots=True)
class Segment:
    """Moves of one ``kind`` (approach, cut, link, ...), of one ``name`` within it, and of one ``phase``.

    The label ``str(segment)`` is ``kind``, ``kind/name`` or ``kind/name_phase``; a name that ends like a
    phase itself is told apart by ``_on``: ``cut/wall_in`` is the way in to ``wall``, ``cut/wall_in_on`` the
    cut of ``wall_in``. Kinds are in lower case. Raises ``ValueError`` for a phase of nothing that has a name,
    and for a kind with a ``/``.
    """

    kind: str
    name: str = ""
    phase: Phase = ""

    def __post_init__(self) -> None:
        if "/" in self.kind or self.phase not in PHASES or (self.phase and not self.name):
            raise ValueError(f"no segment: kind {self.kind!r}, name {self.name!r}, phase {self.phase!r}")
        object.__setattr__(self, "kind", self.kind.lower())

    @staticmethod
    def of(label: str) -> "Segment":
        """The segment that a user means: ``kind`` or ``kind/name``, whatever the name ends with."""
        kind, _, name = label.partition("/")
        return Segment(kind, name)

    @staticmethod
    def read(label: str) -> "Segment":
        """The segment that has this label: the inverse of ``str``."""
        return _read(label)

    def at(self, phase: Phase) -> "Segment":
        """The segment of the same kind and name in another phase."""
        return Segment(self.kind, self.name, phase)

    @property
    def ways(self) -> "tuple[Segment, ...]":
        """The way in, the work and the way out, of the same kind and name."""
        return tuple(self.at(phase) for phase in PHASES)

    @property
    def works(self) -> bool:
        """Whether an edge may touch the stock here."""
        return self.kind in WORKING_KINDS

    @property
    def folded(self) -> "Segment":
        """The segment as programs can tell it: lower case, ASCII, single underscores for all other signs."""
        return _folded(self)

    @property
    def key(self) -> str:
        """The label of :attr:`folded`: two segments that programs cannot tell apart have one key."""
        return str(_folded(self))

    @property
    def word(self) -> str:
        """The label as one word, for the names of things in files: ``cut_wall``."""
        return str(self).replace("/", "_")

    def __str__(self) -> str:
        return _label(self)

    def __format__(self, spec: str) -> str:
        return format(_label(self), spec)


def fold(text: str) -> str:
    """Text in lower case, without accents, with one underscore for each run of what is neither letter nor
    digit, and none at the ends."""
    flat = unicodedata.normalize("NFKD", text)
    kept = "".join(c for c in flat if not unicodedata.combining(c))
    return re.sub(r"[^A-Za-z0-9]+", "_", kept).strip("_").lower()


def clash(segments: Iterable[Segment]) -> tuple[Segment, Segment] | None:
    """The first two of some segments that programs cannot tell apart, or that are the same; else None."""
    known: dict[str, Segment] = {}
    for segment in segments:
        if segment.key in known:
            return known[segment.key], segment
        known[segment.key] = segment
    return None


@functools.lru_cache(maxsize=65536)
def _label(segment: Segment) -> str:
    if not segment.name:
        return segment.kind
    name, phase = segment.name, segment.phase
    alike = _ENDING.fullmatch(name) or _ENDING.fullmatch(fold(name))
    return f"{segment.kind}/{name}" + (f"_{phase or ON_ENDING}" if phase or alike else "")


@functools.lru_cache(maxsize=65536)
def _read(label: str) -> Segment:
    kind, _, text = label.partition("/")
    found = _ENDING.fullmatch(text)
    if found is None:
        return Segment(kind, text)
    return Segment(kind, found[1], "in" if found[2] == "in" else "out" if found[2] == "out" else "")


@functools.lru_cache(maxsize=65536)
def _folded(segment: Segment) -> Segment:
    name = fold(segment.name)
    return Segment(fold(segment.kind), name, segment.phase if name else "")
