"""Comparison of RAPID texts without their comments."""

from __future__ import annotations

from planner.languages.rapid.reader.lexer import Cursor


def text_lines(content: str) -> list[str]:
    """The lines that hold more than a comment: no string, the only other place for a !, goes over a line's
    end."""
    lines = (line.strip(" \t\r") for line in content.split("\n"))
    return [line for line in lines if line and not line.startswith("!")]


def same_text(first: str, second: str) -> bool:
    """Return whether two texts differ in comments and white space at most."""
    return text_lines(first) == text_lines(second) or text_words(first) == text_words(second)


def text_words(content: str) -> list[str]:
    cursor, out = Cursor(content), []
    while cursor.token.kind not in ("end", "bad"):
        out.append(cursor.token.word or cursor.token.text)
        cursor.take()
    return [*out, cursor.token.kind]
