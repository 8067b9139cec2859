"""URScript as text: numbers, poses, straight moves, digital outputs, and popups.

Metres, seconds, radians; a pose is a position and a rotation vector, ``p[x,y,z,rx,ry,rz]``. A blocking
popup holds the program until somebody presses Continue at the panel.
"""

import re
import textwrap
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, from_quaternion, log_rotation
from planner.issues import refusal
from planner.languages.writing.layout import Track, number, plain, short

NAME_LENGTH: Final = 32
"""Longest name that is written [characters]."""
METRE_DECIMALS: Final = 7
"""Decimals of positions in m: those of the targets, which have 4 of mm."""
RADIAN_DECIMALS: Final = 9
"""Decimals of rotation vectors and joints in rad."""
OUTPUTS: Final = range(16)
"""Numbers of digital outputs: 0 to 7 are the standard ones, 8 to 15 the configurable ones."""
_STANDARD: Final = 8
"""How many standard digital outputs there are."""
LEAST_BLEND: Final = 1e-6
"""Least blend radius [m]."""
BLEND_SHARE: Final = 0.45
"""Share of the shorter one of two moves that the blend between them takes at most: blends of neighbours never
touch, for a controller skips a waypoint whose blend meets the next one."""
TEXT_LENGTH: Final = 255
"""Characters of a popup's text."""
AWAIT_LINE, AWAIT_RUNNING = "await_line", "await_running"
"""Functions that wait for the other controller's line, and for what says that its program runs."""
CHECK = "check_partner"
"""The function that looks at both of them at one instant."""
STAND = "stand"
"""The function in place of a move in which only the other arm moves."""
WATCH, WATCHING = "watch_partner", "watching"
"""The thread that ends the program when the other one stops, and the variable that holds it."""
WAIT_STEP: Final = 0.01
"""Time [s] between two looks of a wait."""
SETTLED: Final = 0.1
"""Time [s] behind the rise of the own running wire, until it is read back as it is."""
SEEN: Final = 1.0
"""Time [s] for which a program that begins stands before that wire rises: whoever ran with the one before it
has seen by then that it does not run."""
TITLE, QUESTION, READ = "Tandem", "Tandem asks", "Tandem tells"
"""Titles of popups: of what is told meanwhile, of a question, and of what is read before one."""

_RESERVED_TEXT: Final = """
and break continue def elif else end false for global halt if in local not or return sec thread true while
xor join kill run enter_critical exit_critical struct movej movel movep movec servoj speedj speedl stopj stopl
sleep sync popup textmsg pose_trans pose_inv point_dist get_forward_kin get_inverse_kin set_tcp set_payload
base_frame problem_digest await_line await_running check_partner watch_partner watching passed level limit own
stand seconds arc_lost arc_stood arc_place get_actual_tcp_pose
"""
RESERVED: Final = frozenset(_RESERVED_TEXT.split())
"""Words that no name may be."""
ARC_NAMES: Final = r"(await|watch|watching)_arc(_\d+)?"
"""Names of what waits for torches and watches them, which are no others."""


def name(text: str, length: int = NAME_LENGTH) -> str:
    """A name from text, in small letters: letters, digits and single underscores, a letter first, cut to
    ``length``. Raises :class:`TandemError` (``post.name``) when that gives none."""
    out = re.sub(r"[^a-z0-9]+", "_", plain(text).lower()).strip("_")[:length].rstrip("_")
    if not re.match(r"[a-z]", out) or out in RESERVED or re.fullmatch(ARC_NAMES, out):
        message = f"{text!r} cannot name anything in URScript (it gives {out!r})"
        raise refusal("post.name", message, hint="a letter first, no reserved word")
    return out


def comment(text: str) -> list[str]:
    """Comment lines of plain text, wrapped."""
    return [f"# {line}" for line in textwrap.wrap(plain(text), 100)]


def pose(matrix: FloatArray) -> str:
    """A pose of (4, 4) [m]."""
    vector = log_rotation(matrix[None, :3, :3])[0]
    return written(matrix[:3, 3], vector)


def written(position: Sequence[float] | FloatArray, vector: Sequence[float] | FloatArray) -> str:
    """A pose of a position (3,) [m] and a rotation vector (3,) [rad]."""
    values = [*(number(v, METRE_DECIMALS) for v in position), *(number(v, RADIAN_DECIMALS) for v in vector)]
    return f"p[{','.join(values)}]"


def joints(q: FloatArray) -> str:
    """Joints (6,) [rad] as the controller counts them."""
    return f"[{','.join(number(v, RADIAN_DECIMALS) for v in q)}]"


def real(value: float, decimals: int) -> str:
    """A number with a decimal point and without zeros at its end."""
    text = short(value, decimals)
    return text if "." in text else f"{text}.0"


def vector(values: FloatArray, decimals: int) -> str:
    """A list of numbers."""
    return f"[{','.join(number(v, decimals) for v in values)}]"


def output(number: int, on: bool) -> str:
    """The statement that switches a digital output."""
    word = "True" if on else "False"
    if number < _STANDARD:
        return f"set_standard_digital_out({number},{word})"
    return f"set_configurable_digital_out({number - _STANDARD},{word})"


def input_call(number: int) -> str:
    """The call that reads a digital input, which are numbered as the outputs are."""
    if number < _STANDARD:
        return f"get_standard_digital_in({number})"
    return f"get_configurable_digital_in({number - _STANDARD})"


def output_call(number: int) -> str:
    """The call that reads a digital output back."""
    return input_call(number).replace("_in(", "_out(")


def wait_function(word: str, number: int, own: int, off: Sequence[str], text: str) -> list[str]:
    """A function that waits until the input ``number`` has a level, for a time at most; when that is over, or
    the output ``own`` is low, it does ``off``, shows ``text`` and ends the program."""
    back = output_call(own)
    return [
        f"def {word}(level,limit):",
        "local passed=0.0",
        f"while {input_call(number)}!=level or {back}==False:",
        f"if passed>limit or {back}==False:",
        *off,
        *ended(text),
        "end",
        f"sleep({WAIT_STEP})",
        f"passed=passed+{WAIT_STEP}",
        "end",
        "end",
    ]


def check_function(line: int, runs: int, own: int, off: Sequence[str], text: str) -> list[str]:
    """A function that does ``off``, shows ``text`` and ends the program unless the input ``line`` has a
    level, the input ``runs`` is high, and the output ``own`` has a level of its own."""
    wrong = f"{input_call(line)}!=level or {input_call(runs)}==False or {output_call(own)}!=own"
    return [f"def {CHECK}(level,own):", f"if {wrong}:", *off, *ended(text), "end", "end"]


def watch_thread(number: int, own: int, off: Sequence[str], text: str) -> list[str]:
    """The thread that looks at the input ``number`` and the output ``own`` in every cycle: when one falls it
    does ``off``, shows ``text`` without holding the program, and ends it."""
    return [
        f"thread {WATCH}():",
        f"while {input_call(number)} and {output_call(own)}:",
        "sync()",
        "end",
        *off,
        *ended(text, blocking=False),
        "end",
    ]


def stand_function() -> list[str]:
    """The function of a move of no way: what a controller makes of such a movel no manual says."""
    return [f"def {STAND}(seconds):", "sleep(seconds)", "end"]


def still(track: Track, before: FloatArray) -> BoolArray:
    """Whether (M,) the moves of a track, as written, go nowhere; ``before`` (6,) [rad]: joints ahead of
    them."""
    same = np.all(np.round(np.diff(track.quaternion, axis=0), RADIAN_DECIMALS) == 0.0, axis=1)
    first = np.abs(track.q[:1] - before).max(axis=1) < 1e-9
    return np.asarray((track.distance == 0.0) & np.concatenate([first, same]))


def stays_low(number: int, off: str, text: str) -> list[str]:
    """The program ends when the output ``number`` is on before it has switched anything: it does ``off``
    before the text, for the other program would take this one for one that runs."""
    return [f"if {output_call(number)}:", off, *ended(text), "end"]


def awaited(word: str, value: int, seconds: float) -> str:
    """A wait by one of the functions."""
    return f"{word}({'True' if value else 'False'},{real(seconds, 3)})"


def checked(value: int, own: bool) -> str:
    """A look at the other one's line and both running wires."""
    return f"{CHECK}({'True' if value else 'False'},{own})"


def _text(text: str) -> str:
    """A text in quotes. Raises :class:`TandemError` (``post.name``) for what no popup can show."""
    flat = plain(text)
    if '"' in flat or "\\" in flat or len(flat) > TEXT_LENGTH:
        got = f"a text of {len(flat)} characters" if len(flat) > TEXT_LENGTH else repr(flat)
        what = f"a popup of a UR controller cannot show {got}"
        hint = f"give shorter names, without quotes and backslashes; allowed: {TEXT_LENGTH} characters"
        raise refusal("post.name", what, hint=hint)
    return f'"{flat}"'


def ended(text: str, blocking: bool = True) -> list[str]:
    """The program shows a text, without holding itself unless it is ``blocking``, and ends."""
    return [f'popup({_text(text)},"{TITLE}",False,True,blocking={blocking})', "halt"]


def question(text: str) -> list[str]:
    """A question: Continue is the answer yes; any other button ends the program."""
    return [f'popup({_text(text)},"{QUESTION}",False,False,blocking=True)']


def told(text: str, before_question: bool) -> list[str]:
    """What the operator is told; ``before_question``: read first, for a question follows."""
    if before_question:
        return [f'popup({_text(text)},"{READ}",False,False,blocking=True)']
    return [f'popup({_text(text)},"{TITLE}",False,False,blocking=False)']


def kinematics_check(home: str, tip: FloatArray, place: FloatArray, most: float, text: str) -> list[str]:
    """The program ends unless the controller puts the point ``tip`` (4, 4) of the flange where ``place``
    (4, 4) has it in its base, within ``most`` [m], at the joints called ``home``."""
    return [
        f"if point_dist(get_forward_kin({home},{pose(tip)}),{pose(place)})>{real(most, 6)}:",
        *ended(text),
        "end",
    ]


def movej(target: str, acceleration: float, speed: float) -> str:
    """A move by joints to the data ``target``, at the speed [rad/s] of its leading axis, to an exact stop."""
    return f"movej({target},a={real(acceleration, 4)},v={real(speed, 4)})"


def blends(track: Track, stop: BoolArray) -> FloatArray:
    """Blend radii (M,) [m] of moves, 0 at exact stops, rounded down to micrometres.

    NaN where there is no room for one though the move does not stop: UR's blends are lengths on the way, so
    a tool that turns about its TCP has none.
    """
    way = track.distance
    shorter = np.minimum(way, np.append(way[1:], np.inf))
    room = 1e-3 * np.minimum(track.reach, BLEND_SHARE * shorter)
    radius = np.floor(room * 1e6 + 1e-6) * 1e-6
    return np.where(stop, 0.0, np.where(radius < LEAST_BLEND, np.nan, radius))


def straight(track: Track, radius: FloatArray, frame: str) -> list[str]:
    """The text of all moves of a track in ``frame``: target, time, blend."""
    vectors = log_rotation(from_quaternion(track.quaternion))
    rows = zip(
        (1e-3 * track.position).tolist(),
        vectors.tolist(),
        track.duration.tolist(),
        radius.tolist(),
        strict=True,
    )
    return [
        f"movel(pose_trans({frame},{written(place, turn)}),t={real(time, 5)},r={real(r, 6)})"
        for place, turn, time, r in rows
    ]
