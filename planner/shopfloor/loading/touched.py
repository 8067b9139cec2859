"""Changes that somebody made to programs on a controller: by target and statement, with values.

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
"""Maximum number of pairs of statements that are compared to match them.

In larger differences, statements are paired in order.
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
    """Return the differences between the contents of files of a result and of a controller, by names."""
    out = []
    for name in sorted({*planned, *back}):
        if name not in back or name not in planned:
            message = f"{name} is {'missing on' if name not in back else 'only on'} the controller"
            out.append(_issue(name, message))
        elif planned[name] != back[name]:
            texts = [program_text.decode(content, name) for content in (planned[name], back[name])]
            differences = changes(name, *texts) if kind(name) else _first_line(*texts)
            out += [_issue(name, f"{name}: {difference}") for difference in differences]
    return tuple(out)


def _issue(name: str, message: str) -> Issue:
    return Issue("upload.touched", message, Severity.WARNING, file=name)


def _first_line(first: str, second: str) -> list[str]:
    """Return the first line in which two texts that are not programs differ, apart from line ends."""
    old, new = first.splitlines(), second.splitlines()
    if old == new:
        return []
    pairs = zip(old, new, strict=False)
    shorter = min(len(old), len(new))
    return [f"line {next((k for k, (a, b) in enumerate(pairs, 1) if a != b), shorter + 1)} differs"]


def changes(name: str, first: str, second: str) -> list[str]:
    """Describe the changes of a RAPID or KRL file ``name`` from the text ``first`` to ``second``."""
    old, new = pieces(name, first), pieces(name, second)
    is_krl = kind(name) == "krl"
    out: list[str] = []
    for a, b in _match_statements(old, new):
        if a is not None and b is not None:
            if not a.shape.same(b.shape):
                out += _changed(a, b, is_krl)
        elif b is not None:
            out.append(f"{b.location}: {_type_of(b)} is new: {_shown(b.text)}")
        elif a is not None:
            out.append(f"{a.location} of the result: {_type_of(a)} is gone: {_shown(a.text)}")
    return out


def _match_statements(
    old: Sequence[Piece], new: Sequence[Piece]
) -> Iterator[tuple[Piece | None, Piece | None]]:
    """Yield pairs of old and new statements, with None for a statement that is new or gone."""
    keys = [[piece.shape.key for piece in side] for side in (old, new)]
    for tag, a, b, c, d in difflib.SequenceMatcher(None, keys[0], keys[1], autojunk=False).get_opcodes():
        if tag == "equal" or b - a == d - c:
            yield from zip(old[a:b], new[c:d], strict=True)
        else:
            yield from _by_words(old[a:b], new[c:d])


def _by_words(old: Sequence[Piece], new: Sequence[Piece]) -> Iterator[tuple[Piece | None, Piece | None]]:
    """Yield pairs as :func:`_match_statements`, for runs of different length: matched without numbers."""
    if len(old) * len(new) > MAX_PAIRS:
        shorter = min(len(old), len(new))
        yield from zip(old[:shorter], new[:shorter], strict=True)
        yield from ((piece, None) for piece in old[shorter:])
        yield from ((None, piece) for piece in new[shorter:])
        return
    words = [[piece.shape.words for piece in side] for side in (old, new)]
    for tag, a, b, c, d in difflib.SequenceMatcher(None, words[0], words[1], autojunk=False).get_opcodes():
        if tag == "equal":
            yield from zip(old[a:b], new[c:d], strict=True)
            continue
        paired = min(b - a, d - c)
        yield from zip(old[a : a + paired], new[c : c + paired], strict=True)
        yield from ((piece, None) for piece in old[a + paired : b])
        yield from ((None, piece) for piece in new[c + paired : d])


def _type_of(piece: Piece) -> str:
    """Return the type of a statement for messages: comment, move, signal, wait ..."""
    if piece.comment:
        return "comment"
    if piece.target is not None:
        return "move"
    match = (word for word, pattern in _KINDS if re.match(pattern, piece.text, re.IGNORECASE))
    return next(match, "statement")


def _shown(text: str) -> str:
    """Return a text cut to `MAX_SHOWN_LENGTH` characters."""
    return text if len(text) <= MAX_SHOWN_LENGTH else text[:MAX_SHOWN_LENGTH] + " ..."


def _changed(old: Piece, new: Piece, is_krl: bool) -> list[str]:
    """Describe the changes of a statement: of a move, of the value of a datum, or of the whole text."""
    if old.target is not None and new.target is not None:
        change_texts = _krl_move(old.text, new.text) if is_krl else _rapid_move(old.text, new.text)
        return [f"{new.location}: {change}" for change in change_texts]
    data = [(_KRL_DATUM if is_krl else _RAPID_DATUM).match(piece.text) for piece in (old, new)]
    types = [_type_of(piece) for piece in (old, new)]
    if data[0] and data[1] and types[1] == "statement" and _datum_name(data[0]) == _datum_name(data[1]):
        a, b = data[0].group(3), data[1].group(3)
        change_texts = _krl_value(a, b) if is_krl else _rapid_value(data[1].group(1), a, b)
        title = " ".join(word for word in data[1].groups()[:2] if word)
        return [f"{title} (line {new.line}): {change}" for change in change_texts]
    type_text = types[0] if types[0] == types[1] else f"{types[0]}, now {types[1]},"
    return [f"{new.location}: {type_text} was {_shown(old.text)}, is {_shown(new.text)}"]


def _datum_name(datum: re.Match[str]) -> str:
    return str(datum.group(2)).lower()


# ---- RAPID ----


def _rapid_move(old: str, new: str) -> list[str]:
    """Describe the changes of a move: instruction, target, speed, zone, tool and further arguments."""
    words = [re.match(r"(\w+)\s*(.*?)\s*;?$", text) for text in (old, new)]
    if not words[0] or not words[1]:
        return [f"was {_shown(old)}, is {_shown(new)}"]
    out = []
    if words[0].group(1).lower() != words[1].group(1).lower():
        out.append(f"{words[0].group(1)} is {words[1].group(1)} now")
    first, second = (_arguments(word.group(2)) for word in words if word)
    if len(first) != len(second):
        return [*out, f"was {_shown(old)}, is {_shown(new)}"]
    labels = [*_ARGUMENTS, *(f"argument {k + 1}" for k in range(len(_ARGUMENTS), len(first)))]
    for label, a, b in zip(labels, first, second, strict=False):
        if text_shape(a).same(text_shape(b)):
            continue
        targets = [_BRACKETS.match(text.strip()) for text in (a, b)]
        if label == "target" and targets[0] and targets[1]:
            out += _rapid_value("", targets[0].group(), targets[1].group())
            # what follows the target in brackets, such as \ID
            a, b = (
                text.strip()[len(target.group()) :]
                for text, target in zip((a, b), targets, strict=True)
                if target
            )
            if text_shape(a).same(text_shape(b)):
                continue
            label = "options"
        out.append(f"{label} was {_shown(a)}, is {_shown(b)}")
    return out


def _arguments(text: str) -> list[str]:
    """Split the arguments of a call at commas outside of brackets."""
    out, depth = [""], 0
    for letter in text:
        depth += (letter in "[(") - (letter in "])")
        if letter == "," and depth == 0:
            out.append("")
        else:
            out[-1] += letter
    return out


def _rapid_value(word: str, old: str, new: str) -> list[str]:
    """Describe the difference of two RAPID values; empty if they are equal.

    ``word`` is the data type, "" if it is not stated: then 17 numbers are a robtarget, and 12 a jointtarget.
    """
    first, second = text_shape(old), text_shape(new)
    if first.same(second):
        return []
    if first.words == second.words:
        a, b = (np.array(shape.numbers) for shape in (first, second))
        differing = set(first.differing_numbers(second))
        if len(a) == 17 and word.lower() in ("", "robtarget"):
            external = _axes("external axis", a, b, differing, 11)
            return [", ".join([*_moved(a, b, differing), *_configured(a, b, differing), *external])]
        if len(a) == 12 and word.lower() in ("", "jointtarget"):
            external = _axes("external axis", a, b, differing, 6)
            return [", ".join([*_axes("axis", a, b, differing, 0, 6), *external])]
        if len(a) == 14 and word.lower() == "wobjdata":
            frames = (("user frame", 0), ("object frame", 7))
            return [
                f"{name} {change}"
                for name, start in frames
                for change in _moved(a[start:], b[start:], {k - start for k in differing if k >= start})
            ]
        if len(a) >= 7 and word.lower() in ("pose", "tooldata"):
            change_texts = _moved(a, b, differing)
            rest = [] if differing <= set(range(7)) else [f"was {_shown(old)}, is {_shown(new)}"]
            return [", ".join([*change_texts, *rest])]
    return [f"was {_shown(old)}, is {_shown(new)}"]


def _moved(a: FloatArray, b: FloatArray, differing: set[int]) -> list[str]:
    """Describe the difference of position and quaternion, which are the first seven numbers of a and b."""
    if not differing & set(range(7)):
        return []
    if not (np.linalg.norm(a[3:7]) and np.linalg.norm(b[3:7])):
        return ["the quaternion is zero"]
    return _pose_difference(a[:3], rotation(a[3:7]), b[:3], rotation(b[3:7]))


def _pose_difference(
    a: FloatArray, rotation_a: FloatArray, b: FloatArray, rotation_b: FloatArray
) -> list[str]:
    """Describe the difference of two poses, by positions (3,) [mm] and rotations (3, 3)."""
    distance, angle = float(np.linalg.norm(a - b)), turn_deg(rotation_a, rotation_b)
    return [f"moved by {distance:.3f} mm, turned by {angle:.3f} deg"]


def _configured(a: FloatArray, b: FloatArray, differing: set[int]) -> list[str]:
    """Describe the difference of configuration data, which are the numbers 7 to 10 of a robtarget."""
    if not differing & set(range(7, 11)):
        return []
    old, new = ([int(number) for number in side[7:11]] for side in (a, b))
    return [f"configuration was {old}, is {new}"]


def _axes(
    word: str, a: FloatArray, b: FloatArray, differing: set[int], start: int, end: int | None = None
) -> list[str]:
    """Describe the differences of the axis values from ``start`` to ``end``, which count from 1."""
    indices = range(start, len(a) if end is None else end)
    return [f"{word} {k - start + 1} moved by {b[k] - a[k]:+.3f}" for k in indices if k in differing]


# ---- KRL ----


def _krl_move(old: str, new: str) -> list[str]:
    """Describe the changes of a move: those of its target, and the whole text if the rest differs."""
    first, second = (_BRACES.search(text) for text in (old, new))
    out = _krl_value(first.group(), second.group()) if first and second else []
    rest = [_BRACES.sub("{}", text, count=1) if first and second else text for text in (old, new)]
    if not text_shape(rest[0]).same(text_shape(rest[1])):
        out.append(f"was {_shown(old)}, is {_shown(new)}")
    return out


def _krl_value(old: str, new: str) -> list[str]:
    """Describe the difference of two KRL aggregates by components; empty if they are equal."""
    first, second = text_shape(old), text_shape(new)
    if first.same(second):
        return []
    a, b = ({name.upper(): float(value) for name, value in _COMPONENT.findall(text)} for text in (old, new))
    is_nested = "{" in old[1:] or "{" in new[1:]
    if is_nested or a.keys() != b.keys() or not a:
        return [f"was {_shown(old)}, is {_shown(new)}"]
    differing = {name for name in a if not equal(a[name], b[name])}
    out = []
    if differing & set("XYZABC") and set("XYZABC") <= a.keys():
        frames = [
            from_rpy(
                [values["X"], values["Y"], values["Z"]], np.deg2rad([values["C"], values["B"], values["A"]])
            )
            for values in (a, b)
        ]
        out += _pose_difference(frames[0][:3, 3], frames[0][:3, :3], frames[1][:3, 3], frames[1][:3, :3])
        differing -= set("XYZABC")
    out += [f"{name} was {a[name]:g}, is {b[name]:g}" for name in ("S", "T") if name in differing]
    out += [f"{name} moved by {b[name] - a[name]:+.3f}" for name in a if name in differing - {"S", "T"}]
    return [", ".join(out)] if out else [f"was {_shown(old)}, is {_shown(new)}"]
