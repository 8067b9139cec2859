"""Texts as operators read them, made comparable."""

from __future__ import annotations

import re
import unicodedata


def letters(text: str) -> str:
    """Letters and digits of a text, without accents and case: what survives wrapping and a panel's
    alphabet."""
    return re.sub(r"[^a-z0-9]", "", unicodedata.normalize("NFKD", text).lower())
