"""Numbers and plain text as every robot language takes them."""

from __future__ import annotations

import unicodedata

from planner.dialogue import SPELT


def number(value: float, decimals: int) -> str:
    """A number with a fixed count of decimals and no negative zero."""
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def short(value: float, decimals: int = 6) -> str:
    """A number without zeros at its end."""
    text = number(value, decimals)
    return text.rstrip("0").rstrip(".") if "." in text else text


def plain(text: str) -> str:
    """Text in printable ASCII on one line: accents are dropped, letters such as ß spelt, other foreign
    characters become "?"."""
    flat = unicodedata.normalize("NFKD", " ".join(text.translate(SPELT).split()))
    kept = "".join(c for c in flat if not unicodedata.combining(c))
    return "".join(c if 32 <= ord(c) < 127 else "?" for c in kept)
