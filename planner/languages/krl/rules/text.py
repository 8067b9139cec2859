"""Recognises targets and lines of KRL programs that were changed on the pendant.

Programs are written with 4 decimals of mm and 5 of degrees throughout. KSS writes all digits of single
precision, so that the number of decimals varies with the size of a number (seen in public programs).
"""

import re
from collections.abc import Iterator
from typing import Final

from planner.proof.rules.text import decimals_of

_TARGET: Final = re.compile(r"\{X ([^,}]*),Y ([^,}]*),Z ([^,}]*),A ([^,}]*),B ([^,}]*),C ([^,}]*)")
"""A target, with one group for each number of its position and orientation."""
_NO_TARGET: Final = re.compile(r"\s*DECL\s+(?!E6POS)", re.IGNORECASE)
"""Start of the declaration of a frame or a load, whose numbers look like those of a target."""
_INLINE_FORM: Final = re.compile(
    r"[PFL]DAT_ACT|\$BWDSTART|#(?:PTP|CP)_(?:PARAMS|DAT)|\b(?:S?PTP|S?LIN)\s+X\w+"
    r"|DECL\s+(?:FDAT|[PL]DAT)\b",
    re.IGNORECASE,
)
"""Text that KUKA's inline forms leave in programs and data lists."""
_MM_DECIMALS: Final = 4
_DEGREE_DECIMALS: Final = 5


def target_offsets(text: str) -> Iterator[tuple[int, bool]]:
    """Yield the offset of each target in a file [characters], and whether KSS may have written it."""
    for match in _TARGET.finditer(text):
        if not _NO_TARGET.match(text, text.rfind("\n", 0, match.start()) + 1, match.start()):
            yield match.start(), _is_rewritten(match.groups())


def _is_rewritten(numbers: tuple[str, ...]) -> bool:
    """Return whether KSS, and not the planner, may have written the numbers of a target.

    KSS writes as many decimals as single precision needs. So the position or the angles have more decimals
    than the planner writes, or both have fewer. ``numbers`` are X, Y, Z, A, B and C as written.
    """
    position, angles = (max(map(decimals_of, group)) for group in (numbers[:3], numbers[3:]))
    longer = position > _MM_DECIMALS or angles > _DEGREE_DECIMALS
    return longer or (position < _MM_DECIMALS and angles < _DEGREE_DECIMALS)


def likely_cause(message: str) -> str:
    """Return the likely cause of a message that contains text of KUKA's inline forms, "" for any other."""
    return "changed on the pendant by an inline form; plan again" if _INLINE_FORM.search(message) else ""
