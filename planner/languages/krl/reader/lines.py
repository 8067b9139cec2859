"""Lines of KRL files."""

from __future__ import annotations

import re


def krl_lines(text: str) -> list[str]:
    """Statements of KRL text, without comments and folds, in capitals and without the spaces that count for
    nothing."""
    lines = (re.sub(r";.*", "", line) for line in text.replace("\r\n", "\n").split("\n"))
    tight = (re.sub(r"\s*([=(),\[\]])\s*", r"\1", " ".join(line.split())) for line in lines)
    return [line.upper() for line in tight if line]
