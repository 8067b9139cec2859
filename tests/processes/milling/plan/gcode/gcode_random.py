"""Random G-code with every word that both readers accept, and the statements of the problem about it."""

from __future__ import annotations

import math
import random
from typing import Any

MACHINES = (
    "head_ca",
    "head_cb",
    "head_ab",
    "head_ba",
    "table_ac",
    "table_bc",
    "head_a_table_c",
    "head_b_table_c",
)
OFFSETS = {"G54": [0, 0, 0], "G55": [12.5, -3, 0.25], "G57": [-40, 8, 5]}


def random_settings(rng: random.Random) -> dict[str, Any]:
    """Return random statements of a problem on a file."""
    axis: dict[str, Any] = rng.choice(
        [
            {},
            {"tool_axis": "ijk", "ijk_to": rng.choice(["spindle", "tip"])},
            {"tool_axis": "rotary", "convention": rng.choice(MACHINES), "reverse": rng.choice([[], ["C"]])},
        ]
    )
    if axis.get("reverse") and "C" not in axis["convention"].replace("c", "C"):
        axis["reverse"] = []
    return {
        **axis,
        "unit": rng.choice(["mm", "in"]),
        "distance": rng.choice(["absolute", "incremental"]),
        "motion": "linear",
        "plane": rng.choice(["xy", "zx", "yz"]),
        "arc_centre": "incremental",
        "feed_mode": "per_minute",
        "feed_mm_min": 480.0,
        "spindle_rpm": 5000.0,
        "dwell": "s",
        "start_mm": [rng.uniform(-9, 9), 0.0, 3.0],
        "offsets": OFFSETS,
        "block_delete": rng.random() < 0.5,
        "skip": ["M8", "G28", "G64"],
        "tool": rng.choice([None, None, 2]),
        "origin": {"xyz_mm": [3, -7, 11], "rpy_deg": [20, -35, 130]},
    }


def program(rng: random.Random, settings: dict[str, Any], count: int) -> str:
    """Return ``count`` random lines with the start and end that they need."""
    lines = ["%", "O77 (RANDOM)"]
    if settings["tool"] is not None:
        lines += [f"T{settings['tool']} M6", "M3 S4000", "G0 X0 Y0 Z5"]
    inverse = per_turn = False
    for number in range(count):
        kind = rng.random()
        words: list[str] = [f"N{number}"] if rng.random() < 0.3 else []
        if kind < 0.12:
            words.append(
                rng.choice(["G20", "G21", "G90", "G91", "G54", "G55", "G57", "G40", "G80", "G43 H1"])
            )
        elif kind < 0.2:
            if rng.random() < 0.5:
                words.append(rng.choice(["M3", "M4", "M8", "G64 P0.1", "G4 P1.5", "M1"]))
            else:
                words.append(f"S{rng.randint(1000, 9000)}")
        elif kind < 0.26:
            code = rng.choice(["G93", "G94 F300", "G95 F.2"])
            inverse, per_turn = code == "G93", code.startswith("G95")
            words.append(code)
        elif kind < 0.29:
            words.append("G91 G28 Z0")
        elif kind < 0.33:
            words.append(f"F{rng.uniform(0.1, 2.0) if per_turn or inverse else rng.uniform(50, 900):.2f}")
        elif kind < 0.36 and settings["tool"] is not None:
            lines += [
                "T3 M6",
                "M3",
                "G0 X1 Y2",
                "G1 G94 Z1 F100",
                f"T{settings['tool']} M6",
                "M3",
                "G0 X5.5 Z9",
            ]
            words.append("G94 F200")
            inverse = per_turn = False
        elif kind < 0.55:
            words += arc(rng)
        else:
            words.append(
                rng.choice(["G0", "G1", "G1", "G01", ""]) if "G" not in "".join(lines[-1:]) else "G1"
            )
            words += [f"{axis}{rng.uniform(-60, 60):.3f}" for axis in "XYZ" if rng.random() < 0.7] or ["X1"]
            words += rotary_words(rng, settings)
        moves = any(word[:1] in "XYZ" for word in words)
        if moves and not any(word.startswith("G0") and word != "G01" for word in words):
            words[0:0] = (
                [] if any(word in ("G1", "G01") or "G2" in word or "G3" in word for word in words) else ["G1"]
            )
        if inverse and moves and "G91 G28" not in " ".join(words):
            words.append(f"F{rng.uniform(0.5, 9):.3f}")
        text = rng.choice([" ", "", "  "]).join(words)
        text = text.lower() if rng.random() < 0.1 else text
        text = f"/{text}" if rng.random() < 0.04 and not per_turn and not inverse and moves else text
        lines.append(text + rng.choice(["", "", " (note; X5)", " ; G0 X0 ("]))
    return "\n".join([*lines, "M30", "%", "G1 X999 (not run)"]) + rng.choice(["", "\n"])


def rotary_words(rng: random.Random, settings: dict[str, Any]) -> list[str]:
    """Words that turn the tool."""
    if rng.random() < 0.5 or "tool_axis" not in settings:
        return []
    if settings["tool_axis"] == "ijk":
        tilt, round_ = rng.uniform(0, 1.2), rng.uniform(-3, 3)
        sign = 1 if settings["ijk_to"] == "spindle" else -1
        vector = (math.sin(tilt) * math.cos(round_), math.sin(tilt) * math.sin(round_), math.cos(tilt))
        return [f"{letter}{sign * value:.6f}" for letter, value in zip("IJK", vector, strict=True)]
    letters = sorted(
        set(settings["convention"].replace("head", "").replace("table", "").replace("_", "").upper())
    )
    return [f"{letter}{rng.uniform(-50, 50):.3f}" for letter in letters if rng.random() < 0.7]


def arc(rng: random.Random) -> list[str]:
    """An arc in millimetres or inches by changes, by centre or by radius."""
    code, axes, centre = rng.choice([("G17", "XYZ", "IJ"), ("G18", "ZXY", "KI"), ("G19", "YZX", "JK")])
    radius, begin, way = rng.uniform(1, 8), rng.uniform(-3, 3), rng.choice([-1, 1])
    turn = rng.choice([rng.uniform(0.3, 6.0), 2 * math.pi])
    last = begin + way * turn
    first = (-radius * math.cos(begin), -radius * math.sin(begin))
    step = (first[0] + radius * math.cos(last), first[1] + radius * math.sin(last))
    words = [code, "G91", "G2" if way < 0 else "G3"]
    if turn < 6.1:
        words += [f"{axes[0]}{step[0]:.6f}", f"{axes[1]}{step[1]:.6f}"]
    words += [f"{axes[2]}{rng.uniform(-2, 2):.3f}"] if rng.random() < 0.5 else []
    if 0.3 < turn < 2.9 and rng.random() < 0.5:
        return [*words, f"R{radius:.6f}"]
    if 3.3 < turn < 6.1 and rng.random() < 0.5:
        return [*words, f"R-{radius:.6f}"]
    return [*words, f"{centre[0]}{first[0]:.6f}", f"{centre[1]}{first[1]:.6f}"]
