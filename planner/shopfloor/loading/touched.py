"""Changes that somebody made to programs on a controller: by target and statement, with values.

Two texts are compared by statements. Other notations (160 for 160.0000, CR LF, joined lines) do not count.
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
    is_krl = kind(name) == "krl"
    out: list[str] = []
    for old, new in _match_statements(pieces(name, first), pieces(name, second)):
        if old is not None and new is not None:
            if not old.shape.same(new.shape):
                out += _changed(old, new, is_krl)
        elif new is not None:
            out.append(f"{new.location}: {_type_of(new)} is new: {_shown(new.text)}")
        elif old is not None:
            out.append(f"{old.location} of the result: {_type_of(old)} is gone: {_shown(old.text)}")
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
        old_value, new_value = data[0].group(3), data[1].group(3)
        change_texts = (
            _krl_difference(old_value, new_value)
            if is_krl
            else _rapid_difference(data[1].group(1), old_value, new_value)
        )
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
            out += _rapid_difference("", targets[0].group(), targets[1].group())
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


def _rapid_difference(data_type: str, old: str, new: str) -> list[str]:
    """Describe the difference of two RAPID values in words; empty if they are equal.

    A value that was touched up at the controller is described by the motion of its pose or axes. Other values
    are shown before and after. ``data_type`` is "" if it is not stated: then 17 numbers are a robtarget, and
    12 a jointtarget.
    """
    old_shape, new_shape = text_shape(old), text_shape(new)
    if old_shape.same(new_shape):
        return []
    if old_shape.words == new_shape.words:
        old_numbers, new_numbers = np.array(old_shape.numbers), np.array(new_shape.numbers)
        count = len(old_numbers)
        differing = set(old_shape.differing_numbers(new_shape))
        # robtarget: position (3), quaternion (4), configuration (4), external axes (6)
        if count == 17 and data_type.lower() in ("", "robtarget"):
            pose_texts = _pose_changes(old_numbers, new_numbers, differing)
            configuration_texts = _configuration_changes(old_numbers, new_numbers, differing)
            external_texts = _axis_changes("external axis", old_numbers, new_numbers, differing, 11)
            return [", ".join([*pose_texts, *configuration_texts, *external_texts])]
        if count == 12 and data_type.lower() in ("", "jointtarget"):
            axis_texts = _axis_changes("axis", old_numbers, new_numbers, differing, 0, 6)
            external_texts = _axis_changes("external axis", old_numbers, new_numbers, differing, 6)
            return [", ".join([*axis_texts, *external_texts])]
        if count == 14 and data_type.lower() == "wobjdata":
            frames = (("user frame", 0), ("object frame", 7))
            return [
                f"{name} {change}"
                for name, start in frames
                for change in _pose_changes(
                    old_numbers[start:], new_numbers[start:], {k - start for k in differing if k >= start}
                )
            ]
        if count >= 7 and data_type.lower() in ("pose", "tooldata"):
            change_texts = _pose_changes(old_numbers, new_numbers, differing)
            rest = [] if differing <= set(range(7)) else [f"was {_shown(old)}, is {_shown(new)}"]
            return [", ".join([*change_texts, *rest])]
    return [f"was {_shown(old)}, is {_shown(new)}"]


def _pose_changes(old: FloatArray, new: FloatArray, differing: set[int]) -> list[str]:
    """Describe the difference of position and quaternion, which are the first seven numbers of a datum.

    ``differing`` has the indices of the numbers that differ; empty if these seven are equal.
    """
    if not differing & set(range(7)):
        return []
    if not (np.linalg.norm(old[3:7]) and np.linalg.norm(new[3:7])):
        return ["the quaternion is zero"]
    return _pose_difference(old[:3], rotation(old[3:7]), new[:3], rotation(new[3:7]))


def _pose_difference(
    old: FloatArray, old_rotation: FloatArray, new: FloatArray, new_rotation: FloatArray
) -> list[str]:
    """Describe the difference of two poses, by positions (3,) [mm] and rotations (3, 3)."""
    distance, angle = float(np.linalg.norm(old - new)), turn_deg(old_rotation, new_rotation)
    return [f"moved by {distance:.3f} mm, turned by {angle:.3f} deg"]


def _configuration_changes(old: FloatArray, new: FloatArray, differing: set[int]) -> list[str]:
    """Describe the difference of configuration data, which are the numbers 7 to 10 of a robtarget."""
    if not differing & set(range(7, 11)):
        return []
    old_data, new_data = ([int(number) for number in numbers[7:11]] for numbers in (old, new))
    return [f"configuration was {old_data}, is {new_data}"]


def _axis_changes(
    axis_name: str, old: FloatArray, new: FloatArray, differing: set[int], start: int, end: int | None = None
) -> list[str]:
    """Describe the differences of the axis values among the numbers of a datum.

    The values are the numbers from index ``start`` to ``end`` (exclusive, None for all that follow). Texts
    count the axes from 1. ``differing`` has the indices of the numbers that differ.
    """
    indices = range(start, len(old) if end is None else end)
    return [f"{axis_name} {k - start + 1} moved by {new[k] - old[k]:+.3f}" for k in indices if k in differing]


# ---- KRL ----


def _krl_move(old: str, new: str) -> list[str]:
    """Describe the changes of a move: those of its target, and the whole text if the rest differs."""
    old_target, new_target = (_BRACES.search(text) for text in (old, new))
    out: list[str] = []
    rest = [old, new]
    if old_target and new_target:
        out = _krl_difference(old_target.group(), new_target.group())
        rest = [_BRACES.sub("{}", text, count=1) for text in (old, new)]
    if not text_shape(rest[0]).same(text_shape(rest[1])):
        out.append(f"was {_shown(old)}, is {_shown(new)}")
    return out


def _krl_difference(old: str, new: str) -> list[str]:
    """Describe the difference of two KRL aggregates, such as ``{X 1, Y 2}``, by their components.

    The position and orientation X to C are compared as a pose. Empty if the aggregates are equal.
    """
    if text_shape(old).same(text_shape(new)):
        return []
    old_values, new_values = (
        {name.upper(): float(value) for name, value in _COMPONENT.findall(text)} for text in (old, new)
    )
    is_nested = "{" in old[1:] or "{" in new[1:]
    if is_nested or old_values.keys() != new_values.keys() or not old_values:
        return [f"was {_shown(old)}, is {_shown(new)}"]
    differing = {name for name in old_values if not equal(old_values[name], new_values[name])}
    out = []
    if differing & set("XYZABC") and set("XYZABC") <= old_values.keys():
        frames = [
            from_rpy(
                [values["X"], values["Y"], values["Z"]], np.deg2rad([values["C"], values["B"], values["A"]])
            )
            for values in (old_values, new_values)
        ]
        out += _pose_difference(frames[0][:3, 3], frames[0][:3, :3], frames[1][:3, 3], frames[1][:3, :3])
        differing -= set("XYZABC")
    # status (S) and turn (T) are bit fields, whose difference has no meaning
    out += [
        f"{name} was {old_values[name]:g}, is {new_values[name]:g}"
        for name in ("S", "T")
        if name in differing
    ]
    out += [
        f"{name} moved by {new_values[name] - old_values[name]:+.3f}"
        for name in old_values
        if name in differing - {"S", "T"}
    ]
    return [", ".join(out)] if out else [f"was {_shown(old)}, is {_shown(new)}"]
