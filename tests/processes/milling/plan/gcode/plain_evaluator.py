"""Plain evaluator of straight-line G-code, a character and a line at a time, as a reference.

It shares nothing with the reader but the meaning of the words.
"""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass
class Plain:
    """Moves as (x, y, z, i, j, k, feed or None for rapid, line), in mm and mm/min."""

    moves: list[tuple[float, float, float, float, float, float, float | None, int]] = dataclasses.field(
        default_factory=list
    )


def _letters(line: str) -> list[tuple[str, float]]:
    out: list[tuple[str, float]] = []
    depth, text = 0, ""
    for sign in line:
        if sign == ";" and depth == 0:
            break
        if sign == "(":
            depth += 1
        elif sign == ")":
            depth -= 1
        elif depth == 0 and not sign.isspace():
            text += sign.upper()
    letter, number = "", ""
    for sign in text + "?":
        if sign.isalpha() or sign == "?":
            if letter:
                out.append((letter, float(number)))
            letter, number = sign, ""
        else:
            number += sign
    return out


def evaluate(text: str) -> Plain:
    """The moves of a program of G0 G1 G20 G21 G90 G91, X Y Z I J K, F and N."""
    out = Plain()
    at = {"X": 0.0, "Y": 0.0, "Z": 0.0, "I": 0.0, "J": 0.0, "K": 1.0}
    scale, relative, cutting, feed = 1.0, False, False, 0.0
    for number, line in enumerate(text.split("\n"), start=1):
        found = _letters(line)
        for letter, value in found:
            if letter == "G":
                if value in (20, 21):
                    scale = 25.4 if value == 20 else 1.0
                elif value in (90, 91):
                    relative = value == 91
                elif value in (0, 1):
                    cutting = value == 1
        moved = False
        for letter, value in found:
            if letter == "F":
                feed = value * scale
            elif letter in "XYZ":
                at[letter] = value * scale + (at[letter] if relative else 0.0)
                moved = True
            elif letter in "IJK":
                at[letter] = value
                moved = True
        if moved:
            size = (at["I"] ** 2 + at["J"] ** 2 + at["K"] ** 2) ** 0.5
            out.moves.append(
                (
                    at["X"],
                    at["Y"],
                    at["Z"],
                    at["I"] / size,
                    at["J"] / size,
                    at["K"] / size,
                    feed if cutting else None,
                    number,
                )
            )
    return out
