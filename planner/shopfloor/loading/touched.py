"""Changes that somebody made to programs on a controller: by target and statement, with figures.

Two texts are compared by statements. Different prints (160 for 160.0000, CR LF, joined lines) are no changes.
Positions are in mm and rotations in degrees: in RAPID from quaternions, in KRL from A, B, C, which are A
about z, B about the new y, C about the new x (KUKA, KSS operating and programming instructions).
"""

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, from_rpy
from planner.issues import Issue, Severity
from planner.programs import text as program_text
from planner.programs.steps import rotation
from planner.shopfloor.loading.literals import equal, text_shape, turn_deg
from planner.shopfloor.loading.pieces import Piece, kind, pieces

MAX_PAIRS: Final = 4_000_000
"""Maximum number of pairs of statements that are compared to match them. Larger differences are reported as
one block.
"""
MAX_SHOWN_LENGTH: Final = 160
"""Maximum number of characters of a displayed statement."""
_BRACKETS: Final = re.compile(r"\[\s*\[[^;]*?\]\s*\](?=\s*(?:[,\\;]|$))")
_BRACES: Final = re.compile(r"\{[^{}]*\}")
_COMPONENT: Final = re.compile(r"\b([A-Z]\w?)\s+([-+]?[\d.]+(?:[eE][-+]?\d+)?)", re.IGNORECASE)
_RAPID_DATUM: Final = re.compile(
    r"(?:LOCAL\s+|TASK\s+)*(?:CONST|PERS|VAR)\s+(\w+)\s+(\w+)(?:\{[\d,]+\})?\s*:=\s*(.*?)\s*;?$",
    re.IGNORECASE,
)
_KRL_DATUM: Final = re.compile(
    r"(?:DECL\s+)?(?:GLOBAL\s+)?(?:CONST\s+)?(?:(\w+)\s+)?(\$?\w+(?:\.\w+)*(?:\[\d*,?\])?)\s*=\s*(.*)$",
    re.IGNORECASE,
)
_KINDS: Final = (
    ("signal", r"(?:SetDO|SetGO|SetAO|Set|Reset|PulseDO|InvertDO)\b|\$(?:OUT|ANOUT)\b|PULSE\b|ANOUT\b"),
    ("wait", r"Wait\w*\b|WAIT\b|HALT\b|Stop\b"),
    ("speed", r"VelSet\b|AccSet\b|PathAccLim\b|WorldAccLim\b|SpeedRefresh\b|\$(?:VEL|ACC|OV_PRO)|BAS\b"),
    ("zone", r"\$APO"),
    ("frame", r"\$(?:TOOL|BASE|LOAD|ROBROOT|IPO_MODE|ORI_TYPE)\b|GripLoad\b|PDisp\w+\b|EOffs\w+\b"),
    ("message", r"TPWrite\b|TPErase\b|UIMsgBox\b|TPReadFK\b|ErrWrite\b|tm_\w+"),
)
_ARGUMENTS: Final = ("target", "speed", "zone", "tool or work object")
"""Arguments of RAPID's moves, in order."""


def touched(planned: Mapping[str, bytes], back: Mapping[str, bytes]) -> tuple[Issue, ...]:
    """Differences between the files of a result and those that were fetched, by file and place."""
    out = []
    for name in sorted({*planned, *back}):
        if name not in back or name not in planned:
            what = f"{name} is {'missing on' if name not in back else 'only on'} the controller"
            out.append(_issue(name, what))
        elif planned[name] != back[name]:
            texts = [program_text.decode(content, name) for content in (planned[name], back[name])]
            found = changes(name, *texts) if kind(name) else _first_line(*texts)
            out += [_issue(name, f"{name}: {what}") for what in found]
    return tuple(out)


def _issue(name: str, what: str) -> Issue:
    return Issue("upload.touched", what, Severity.WARNING, file=name)


def _first_line(first: str, second: str) -> list[str]:
    """For files that are not programs: the first line that differs in more than its line end."""
    old, new = first.splitlines(), second.splitlines()
    if old == new:
        return []
    pairs = zip(old, new, strict=False)
    short = min(len(old), len(new))
    return [f"line {next((k for k, (a, b) in enumerate(pairs, 1) if a != b), short + 1)} differs"]


def changes(name: str, first: str, second: str) -> list[str]:
    """Describe the changes of a RAPID or KRL file ``name`` from the text ``first`` to ``second``."""
    old, new = pieces(name, first), pieces(name, second)
    krl = kind(name) == "krl"
    out: list[str] = []
    for a, b in _match_statements(old, new):
        if a is not None and b is not None:
            out += [] if a.shape.same(b.shape) else _changed(a, b, krl)
        elif b is not None:
            out.append(f"{b.location}: {_what(b)} is new: {_shown(b.text)}")
        elif a is not None:
            out.append(f"{a.location} of the result: {_what(a)} is gone: {_shown(a.text)}")
    return out


def _match_statements(
    old: Sequence[Piece], new: Sequence[Piece]
) -> Iterator[tuple[Piece | None, Piece | None]]:
    """Pairs of old and new statements; None for the missing side."""
    keys = [[one.shape.key for one in side] for side in (old, new)]
    for tag, a, b, c, d in difflib.SequenceMatcher(None, keys[0], keys[1], autojunk=False).get_opcodes():
        if tag == "equal" or b - a == d - c:
            yield from zip(old[a:b], new[c:d], strict=True)
        else:
            yield from _by_words(old[a:b], new[c:d])


def _by_words(old: Sequence[Piece], new: Sequence[Piece]) -> Iterator[tuple[Piece | None, Piece | None]]:
    """Pairs as :func:`_match_statements`, for runs of different length: by their words, ignoring numbers."""
    if len(old) * len(new) > MAX_PAIRS:
        shorter = min(len(old), len(new))
        yield from zip(old[:shorter], new[:shorter], strict=True)
        yield from ((one, None) for one in old[shorter:])
        yield from ((None, one) for one in new[shorter:])
        return
    words = [[one.shape.words for one in side] for side in (old, new)]
    for tag, a, b, c, d in difflib.SequenceMatcher(None, words[0], words[1], autojunk=False).get_opcodes():
        if tag == "equal":
            yield from zip(old[a:b], new[c:d], strict=True)
            continue
        both = min(b - a, d - c)
        yield from zip(old[a : a + both], new[c : c + both], strict=True)
        yield from ((one, None) for one in old[a + both : b])
        yield from ((None, one) for one in new[c + both : d])


def _what(piece: Piece) -> str:
    if piece.comment:
        return "comment"
    if piece.target is not None:
        return "move"
    match = (word for word, pattern in _KINDS if re.match(pattern, piece.text, re.IGNORECASE))
    return next(match, "statement")


def _shown(text: str) -> str:
    return text if len(text) <= MAX_SHOWN_LENGTH else text[:MAX_SHOWN_LENGTH] + " ..."


def _changed(old: Piece, new: Piece, krl: bool) -> list[str]:
    if old.target is not None and new.target is not None:
        change_texts = _krl_move(old.text, new.text) if krl else _rapid_move(old.text, new.text)
        return [f"{new.location}: {what}" for what in change_texts]
    data = [(_KRL_DATUM if krl else _RAPID_DATUM).match(one.text) for one in (old, new)]
    words = [_what(one) for one in (old, new)]
    if data[0] and data[1] and words[1] == "statement" and _named(data[0]) == _named(data[1]):
        a, b = data[0].group(3), data[1].group(3)
        change_texts = _krl_value(a, b) if krl else _rapid_value(data[1].group(1), a, b)
        shown = " ".join(word for word in data[1].groups()[:2] if word)
        return [f"{shown} (line {new.line}): {what}" for what in change_texts]
    word = words[0] if words[0] == words[1] else f"{words[0]}, now {words[1]},"
    return [f"{new.location}: {word} was {_shown(old.text)}, is {_shown(new.text)}"]


def _named(datum: re.Match[str]) -> str:
    return str(datum.group(2)).lower()


# ---- RAPID ----


def _rapid_move(old: str, new: str) -> list[str]:
    words = [re.match(r"(\w+)\s*(.*?)\s*;?$", text) for text in (old, new)]
    if not words[0] or not words[1]:
        return [f"was {_shown(old)}, is {_shown(new)}"]
    out = []
    if words[0].group(1).lower() != words[1].group(1).lower():
        out.append(f"{words[0].group(1)} is {words[1].group(1)} now")
    first, second = (_arguments(one.group(2)) for one in words if one)
    if len(first) != len(second):
        return [*out, f"was {_shown(old)}, is {_shown(new)}"]
    named = [*_ARGUMENTS, *(f"argument {k + 1}" for k in range(len(_ARGUMENTS), len(first)))]
    for label, a, b in zip(named, first, second, strict=False):
        if text_shape(a).same(text_shape(b)):
            continue
        places = [_BRACKETS.match(text.strip()) for text in (a, b)]
        if label == "target" and places[0] and places[1]:
            out += _rapid_value("", places[0].group(), places[1].group())
            a, b = (text.strip()[len(at.group()) :] for text, at in zip((a, b), places, strict=True) if at)
            if text_shape(a).same(text_shape(b)):
                continue
            label = "options"
        out.append(f"{label} was {_shown(a)}, is {_shown(b)}")
    return out


def _arguments(text: str) -> list[str]:
    """Arguments of a call, split at commas outside of brackets."""
    out, depth = [""], 0
    for letter in text:
        depth += (letter in "[(") - (letter in "])")
        if letter == "," and depth == 0:
            out.append("")
        else:
            out[-1] += letter
    return out


def _rapid_value(word: str, old: str, new: str) -> list[str]:
    """Differences of two RAPID values; 17 numbers are a robtarget, 12 a jointtarget, 7 a pose."""
    first, second = text_shape(old), text_shape(new)
    if first.same(second):
        return []
    if first.words == second.words:
        a, b = (np.array(one.numbers) for one in (first, second))
        differing = set(first.differing_numbers(second))
        if len(a) == 17 and word.lower() in ("", "robtarget"):
            external = _axes("external axis", a, b, differing, 11)
            return [", ".join([*_moved(a, b, differing), *_configured(a, b, differing), *external])]
        if len(a) == 12 and word.lower() in ("", "jointtarget"):
            external = _axes("external axis", a, b, differing, 6)
            return [", ".join([*_axes("axis", a, b, differing, 0, 6), *external])]
        if len(a) == 14 and word.lower() == "wobjdata":
            halves = (("user frame", 0), ("object frame", 7))
            return [
                f"{name} {what}"
                for name, start in halves
                for what in _moved(a[start:], b[start:], {k - start for k in differing if k >= start})
            ]
        if len(a) >= 7 and word.lower() in ("pose", "tooldata"):
            change_texts = _moved(a, b, differing)
            rest = [] if differing <= set(range(7)) else [f"was {_shown(old)}, is {_shown(new)}"]
            return [", ".join([*change_texts, *rest])]
    return [f"was {_shown(old)}, is {_shown(new)}"]


def _moved(a: FloatArray, b: FloatArray, differing: set[int]) -> list[str]:
    """Differences of a position and a quaternion, which are the first seven numbers."""
    if not differing & set(range(7)):
        return []
    if not (np.linalg.norm(a[3:7]) and np.linalg.norm(b[3:7])):
        return ["the quaternion is zero"]
    return _pose_difference(a[:3], rotation(a[3:7]), b[:3], rotation(b[3:7]))


def _pose_difference(a: FloatArray, turned_a: FloatArray, b: FloatArray, turned_b: FloatArray) -> list[str]:
    way, turn = float(np.linalg.norm(a - b)), turn_deg(turned_a, turned_b)
    return [f"moved by {way:.3f} mm, turned by {turn:.3f} deg"]


def _configured(a: FloatArray, b: FloatArray, differing: set[int]) -> list[str]:
    if not differing & set(range(7, 11)):
        return []
    old, new = ([int(n) for n in side[7:11]] for side in (a, b))
    return [f"configuration was {old}, is {new}"]


def _axes(
    word: str, a: FloatArray, b: FloatArray, differing: set[int], start: int, end: int | None = None
) -> list[str]:
    rows = range(start, len(a) if end is None else end)
    return [f"{word} {k - start + 1} moved by {b[k] - a[k]:+.3f}" for k in rows if k in differing]


# ---- KRL ----


def _krl_move(old: str, new: str) -> list[str]:
    first, second = (_BRACES.search(text) for text in (old, new))
    out = _krl_value(first.group(), second.group()) if first and second else []
    rest = [_BRACES.sub("{}", text, count=1) if first and second else text for text in (old, new)]
    if not text_shape(rest[0]).same(text_shape(rest[1])):
        out.append(f"was {_shown(old)}, is {_shown(new)}")
    return out


def _krl_value(old: str, new: str) -> list[str]:
    """Differences of two KRL aggregates, by components."""
    first, second = text_shape(old), text_shape(new)
    if first.same(second):
        return []
    a, b = ({k.upper(): float(v) for k, v in _COMPONENT.findall(text)} for text in (old, new))
    nested = "{" in old[1:] or "{" in new[1:]
    if nested or a.keys() != b.keys() or not a:
        return [f"was {_shown(old)}, is {_shown(new)}"]
    differing = {name for name in a if not equal(a[name], b[name])}
    out = []
    if differing & set("XYZABC") and set("XYZABC") <= a.keys():
        sides = [from_rpy([s["X"], s["Y"], s["Z"]], np.deg2rad([s["C"], s["B"], s["A"]])) for s in (a, b)]
        out += _pose_difference(sides[0][:3, 3], sides[0][:3, :3], sides[1][:3, 3], sides[1][:3, :3])
        differing -= set("XYZABC")
    out += [f"{name} was {a[name]:g}, is {b[name]:g}" for name in ("S", "T") if name in differing]
    out += [f"{name} moved by {b[name] - a[name]:+.3f}" for name in a if name in differing - {"S", "T"}]
    return [", ".join(out)] if out else [f"was {_shown(old)}, is {_shown(new)}"]
