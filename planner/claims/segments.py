"""Segments of a path: their kinds, phases and names."""

import dataclasses
import functools
import re
import unicodedata
from collections.abc import Iterable
from typing import Final, Literal

Phase = Literal["", "in", "out"]
PHASES: Final[tuple[Phase, ...]] = ("in", "", "out")
"""Phases in the order in which they occur: lead-in, work, lead-out."""
WORKING_KINDS: Final = frozenset({"cut", "form", "mill", "trim"})
"""Kinds of segments in which a tool's working end may touch the stock."""
ON_ENDING: Final = "on"
"""Ending that marks a label without a phase, if the name of the segment ends like a phase."""
_ENDING: Final = re.compile(rf"(.+)_(in|out|{ON_ENDING})", re.DOTALL)
"""Label of a segment with a phase, or with the mark that it has none."""


@dataclasses.dataclass(frozen=True, slots=True)
class Segment:
    """A part of a path, identified by kind, name and phase.

    The label ``str(segment)`` is ``kind``, ``kind/name`` or ``kind/name_phase``. A name that ends like a
    phase is marked by ``_on``: ``cut/wall_in`` is the lead-in to ``wall``, ``cut/wall_in_on`` the cut of
    ``wall_in``.

    Attributes:
        kind: Kind (approach, cut, link, ...) in lower case.
        name: Name within the kind.
        phase: Phase.

    Raises:
        ValueError: The kind contains a ``/``, the phase is unknown, or there is a phase but no name.
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
        """Return the segment that a user means by ``kind`` or ``kind/name``; ``_in`` is part of the name."""
        kind, _, name = label.partition("/")
        return Segment(kind, name)

    @staticmethod
    def read(label: str) -> "Segment":
        """Return the segment with a label that ``str`` made; an ending such as ``_in`` is its phase."""
        return _read(label)

    def at(self, phase: Phase) -> "Segment":
        """Return the segment of the same kind and name in another phase."""
        return Segment(self.kind, self.name, phase)

    @property
    def all_phases(self) -> "tuple[Segment, ...]":
        """Lead-in, work and lead-out of the same kind and name."""
        return tuple(self.at(phase) for phase in PHASES)

    @property
    def works(self) -> bool:
        """Whether the working end of a tool may touch the stock in this segment."""
        return self.kind in WORKING_KINDS

    @property
    def folded(self) -> "Segment":
        """The segment as programs can express it, with names in lower-case ASCII, see :func:`fold`."""
        return _folded(self)

    @property
    def key(self) -> str:
        """The label of :attr:`folded`. Segments that programs cannot distinguish have one key."""
        return str(_folded(self))

    @property
    def word(self) -> str:
        """The label as one word, for names in files: ``cut_wall``."""
        return str(self).replace("/", "_")

    def __str__(self) -> str:
        return _label(self)

    def __format__(self, spec: str) -> str:
        return format(_label(self), spec)


def fold(text: str) -> str:
    """Return text in lower-case ASCII without accents.

    Each run of characters other than letters and digits becomes one underscore. Underscores at the ends are
    dropped.
    """
    decomposed = unicodedata.normalize("NFKD", text)
    kept = "".join(c for c in decomposed if not unicodedata.combining(c))
    return re.sub(r"[^A-Za-z0-9]+", "_", kept).strip("_").lower()


def first_clash(segments: Iterable[Segment]) -> tuple[Segment, Segment] | None:
    """Return the first two segments that are equal or that programs cannot distinguish, else None."""
    segments_by_key: dict[str, Segment] = {}
    for segment in segments:
        if segment.key in segments_by_key:
            return segments_by_key[segment.key], segment
        segments_by_key[segment.key] = segment
    return None


@functools.lru_cache(maxsize=65536)
def _label(segment: Segment) -> str:
    """Return the label of a segment, by which files, messages and programs name it.

    The form is ``kind`` for a segment without a name, ``kind/name`` for one without a phase, and
    ``kind/name_in`` or ``kind/name_out`` for a lead-in or lead-out.

    A segment without a phase gets the ending ``_on`` if its name itself ends in ``_in``, ``_out`` or ``_on``.
    Otherwise the reader of the label would take this ending for a phase. The folded name counts, too, because
    programs contain it: a name that ends in ``-in`` ends in ``_in`` there.

    The result is cached, because labels are read very often.
    """
    if not segment.name:
        return segment.kind
    name, phase = segment.name, segment.phase
    ends_like_phase = _ENDING.fullmatch(name) or _ENDING.fullmatch(fold(name))
    return f"{segment.kind}/{name}" + (f"_{phase or ON_ENDING}" if phase or ends_like_phase else "")


@functools.lru_cache(maxsize=65536)
def _read(label: str) -> Segment:
    """Return the segment with a label that :func:`_label` made; cached, because labels are read very often.

    The ending ``_in`` or ``_out`` is the phase. The ending ``_on`` is dropped: it marks that the segment has
    no phase, although its name ends like one.
    """
    kind, _, text = label.partition("/")
    match = _ENDING.fullmatch(text)
    if match is None:
        return Segment(kind, text)
    return Segment(kind, match[1], "in" if match[2] == "in" else "out" if match[2] == "out" else "")


@functools.lru_cache(maxsize=65536)
def _folded(segment: Segment) -> Segment:
    """Return a segment as programs can express it. Without a name that is left, it has no phase."""
    name = fold(segment.name)
    return Segment(fold(segment.kind), name, segment.phase if name else "")
