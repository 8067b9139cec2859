"""Targets and lines of KRL programs that somebody changed on the pendant.

Programs are written with 4 decimals of mm and 5 of degrees throughout. KSS writes all digits of single
precision, so that the decimals vary with the size of a number (seen in public programs).
"""

import re
from collections.abc import Iterator
from typing import Final

from planner.proof.rules.text import decimals_of

_TARGET: Final = re.compile(r"\{X ([^,}]*),Y ([^,}]*),Z ([^,}]*),A ([^,}]*),B ([^,}]*),C ([^,}]*)")
"""A target: its position and its orientation."""
_NO_TARGET: Final = re.compile(r"\s*DECL\s+(?!E6POS)", re.IGNORECASE)
"""What stands before a frame or a load."""
_INLINE_FORM: Final = re.compile(
    r"[PFL]DAT_ACT|\$BWDSTART|#(?:PTP|CP)_(?:PARAMS|DAT)|\b(?:S?PTP|S?LIN)\s+X\w+"
    r"|DECL\s+(?:FDAT|[PL]DAT)\b",
    re.IGNORECASE,
)
"""What KUKA's inline forms leave in programs and data lists."""
_MM_DECIMALS: Final = 4
_DEGREE_DECIMALS: Final = 5


def targets_in(text: str) -> Iterator[tuple[int, bool]]:
    """Yield where targets stand in a file, and whether KSS may have written each of them."""
    for found in _TARGET.finditer(text):
        if not _NO_TARGET.match(text, text.rfind("\n", 0, found.start()) + 1, found.start()):
            yield found.start(), _rewritten(found.groups())


def _rewritten(numbers: tuple[str, ...]) -> bool:
    """Return whether the numbers have more decimals, or all of them fewer, than programs are written with."""
    position, angles = (max(map(decimals_of, some)) for some in (numbers[:3], numbers[3:]))
    longer = position > _MM_DECIMALS or angles > _DEGREE_DECIMALS
    return longer or (position < _MM_DECIMALS and angles < _DEGREE_DECIMALS)


def likely_cause(message: str) -> str:
    """Return that an inline form has written what a message is about, "" if it has not."""
    return "changed on the pendant by an inline form; plan again" if _INLINE_FORM.search(message) else ""
