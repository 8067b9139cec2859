"""URScript as text: numbers, poses, straight moves, digital outputs, and popups.

Units are metres, seconds, radians. A pose is a position and a rotation vector, ``p[x,y,z,rx,ry,rz]``. A
blocking popup holds the program until somebody presses Continue at the panel.
"""

import re
import textwrap
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, from_quaternion, log_rotation
from planner.issues import issue_error
from planner.languages.writing.layout import MoveTable, format_fixed, format_short, to_ascii

NAME_LENGTH: Final = 32
"""Maximum length [characters] of a written name."""
METRE_DECIMALS: Final = 7
"""Decimals of positions in m: those of the targets, which have 4 of mm."""
RADIAN_DECIMALS: Final = 9
"""Decimals of rotation vectors and joints in rad."""
OUTPUTS: Final = range(16)
"""Numbers of digital outputs: 0 to 7 are the standard ones, 8 to 15 the configurable ones."""
_STANDARD: Final = 8
"""Number of standard digital outputs."""
MIN_BLEND_M: Final = 1e-6
"""Minimum blend radius [m]."""
MAX_BLEND_FRACTION: Final = 0.45
"""Maximum fraction of the shorter of two moves that the blend between them takes.
Adjacent blends never touch, because a controller skips a waypoint whose blend meets the next one.
"""
TEXT_LENGTH: Final = 255
"""Maximum length [characters] of a popup's text."""
AWAIT_LINE, AWAIT_RUNNING = "await_line", "await_running"
"""Functions that wait for the other controller's line, and for the wire that shows that its program
runs.
"""
CHECK = "check_partner"
"""Function that checks both of them at one instant."""
STAND = "stand"
"""Function that replaces a move in which only the other arm moves."""
WATCH, WATCHING = "watch_partner", "watching"
"""Thread that ends the program when the other one stops, and the variable that holds it."""
WAIT_STEP: Final = 0.01
"""Time [s] between two checks of a wait."""
SETTLING_TIME_S: Final = 0.1
"""Time [s] after the rise of the program's running wire, until it is read back correctly."""
START_PAUSE_S: Final = 1.0
"""Time [s] for which a starting program waits before that wire rises.
A program that ran with its predecessor has seen by then that it does not run.
"""
TITLE, QUESTION, READ = "Tandem", "Tandem asks", "Tandem tells"
"""Titles of popups: of texts that are shown meanwhile, of a question, and of a text that is read before
one.
"""

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
"""Names of functions, threads and variables of torches, which no other name may be."""


def name(text: str, length: int = NAME_LENGTH) -> str:
    """Return a name made from text: lower-case letters, digits and single underscores.

    It starts with a letter and is cut to ``length``.

    Raises:
        TandemError: The text gives no valid name (``post.name``).
    """
    out = re.sub(r"[^a-z0-9]+", "_", to_ascii(text).lower()).strip("_")[:length].rstrip("_")
    if not re.match(r"[a-z]", out) or out in RESERVED or re.fullmatch(ARC_NAMES, out):
        message = f"{text!r} cannot name anything in URScript (it gives {out!r})"
        raise issue_error("post.name", message, hint="start with a letter, and use no reserved word")
    return out


def comment(text: str) -> list[str]:
    """Return comment lines of plain text, wrapped."""
    return [f"# {line}" for line in textwrap.wrap(to_ascii(text), 100)]


def pose(matrix: FloatArray) -> str:
    """Format a pose (4, 4) [m]."""
    vector = log_rotation(matrix[None, :3, :3])[0]
    return format_pose(matrix[:3, 3], vector)


def format_pose(position: Sequence[float] | FloatArray, vector: Sequence[float] | FloatArray) -> str:
    """Format a pose of a position (3,) [m] and a rotation vector (3,) [rad]."""
    values = [
        *(format_fixed(v, METRE_DECIMALS) for v in position),
        *(format_fixed(v, RADIAN_DECIMALS) for v in vector),
    ]
    return f"p[{','.join(values)}]"


def format_joints(q: FloatArray) -> str:
    """Format joints (6,) [rad] as the controller counts them."""
    return f"[{','.join(format_fixed(v, RADIAN_DECIMALS) for v in q)}]"


def format_real(value: float, decimals: int) -> str:
    """Format a number with a decimal point and without trailing zeros."""
    text = format_short(value, decimals)
    return text if "." in text else f"{text}.0"


def format_vector(values: FloatArray, decimals: int) -> str:
    """Format a list of numbers."""
    return f"[{','.join(format_fixed(v, decimals) for v in values)}]"


def output(number: int, on: bool) -> str:
    """Return the statement that switches a digital output."""
    word = "True" if on else "False"
    if number < _STANDARD:
        return f"set_standard_digital_out({number},{word})"
    return f"set_configurable_digital_out({number - _STANDARD},{word})"


def input_call(number: int) -> str:
    """Return the call that reads a digital input. Inputs are numbered like outputs."""
    if number < _STANDARD:
        return f"get_standard_digital_in({number})"
    return f"get_configurable_digital_in({number - _STANDARD})"


def output_call(number: int) -> str:
    """Return the call that reads a digital output back."""
    return input_call(number).replace("_in(", "_out(")


def wait_function(
    word: str, number: int, running: int, off_statements: Sequence[str], text: str
) -> list[str]:
    """Return a function that waits until an input has a level.

    When the time is over, or the running wire is low, it switches off, shows a text and ends the program.

    Args:
        word: Name of the function.
        number: Number of the input.
        running: Number of the running wire's output.
        off_statements: Statements that switch off.
        text: The text.
    """
    back = output_call(running)
    return [
        f"def {word}(level,limit):",
        "local passed=0.0",
        f"while {input_call(number)}!=level or {back}==False:",
        f"if passed>limit or {back}==False:",
        *off_statements,
        *ending(text),
        "end",
        f"sleep({WAIT_STEP})",
        f"passed=passed+{WAIT_STEP}",
        "end",
        "end",
    ]


def check_function(line: int, runs: int, running: int, off_statements: Sequence[str], text: str) -> list[str]:
    """Return a function that ends the program unless the other program is as expected.

    It switches off, shows a text and ends the program unless the input ``line`` has a level, the input
    ``runs`` is high, and the output ``running`` has a level of its own.
    """
    wrong = f"{input_call(line)}!=level or {input_call(runs)}==False or {output_call(running)}!=own"
    return [f"def {CHECK}(level,own):", f"if {wrong}:", *off_statements, *ending(text), "end", "end"]


def watch_thread(number: int, running: int, off_statements: Sequence[str], text: str) -> list[str]:
    """Return the thread that checks the input ``number`` and the output ``running`` in every cycle.

    When one falls, it switches off, shows ``text`` without holding the program, and ends it.
    """
    return [
        f"thread {WATCH}():",
        f"while {input_call(number)} and {output_call(running)}:",
        "sync()",
        "end",
        *off_statements,
        *ending(text, blocking=False),
        "end",
    ]


def stand_function() -> list[str]:
    """Return the function of a move of zero length.

    No manual states how a controller executes such a movel.
    """
    return [f"def {STAND}(seconds):", "sleep(seconds)", "end"]


def stationary_moves(track: MoveTable, start_joints: FloatArray) -> BoolArray:
    """Return which moves (M,) of a track, as written, have zero length.

    ``start_joints`` (6,) [rad] are the joints before them.
    """
    same = np.all(np.round(np.diff(track.quaternion, axis=0), RADIAN_DECIMALS) == 0.0, axis=1)
    first = np.abs(track.q[:1] - start_joints).max(axis=1) < 1e-9
    return np.asarray((track.distance == 0.0) & np.concatenate([first, same]))


def low_check(number: int, off_statement: str, text: str) -> list[str]:
    """Return statements that end the program if the output ``number`` is already on.

    They run before the program has switched anything. The output is switched off before the text, because the
    other program would take this one for a running one.
    """
    return [f"if {output_call(number)}:", off_statement, *ending(text), "end"]


def wait_call(word: str, value: int, seconds: float) -> str:
    """Return a wait by one of the functions."""
    return f"{word}({'True' if value else 'False'},{format_real(seconds, 3)})"


def partner_check(value: int, running: bool) -> str:
    """Return a check of the other one's line and both running wires."""
    return f"{CHECK}({'True' if value else 'False'},{running})"


def _text(text: str) -> str:
    """Return a text in quotes.

    Raises:
        TandemError: No popup can show the text (``post.name``).
    """
    flat = to_ascii(text)
    if '"' in flat or "\\" in flat or len(flat) > TEXT_LENGTH:
        got = f"a text of {len(flat)} characters" if len(flat) > TEXT_LENGTH else repr(flat)
        what = f"a popup of a UR controller cannot show {got}"
        hint = f"give shorter names, without quotes and backslashes; allowed: {TEXT_LENGTH} characters"
        raise issue_error("post.name", what, hint=hint)
    return f'"{flat}"'


def ending(text: str, blocking: bool = True) -> list[str]:
    """Return statements that show a text, holding the program if ``blocking``, and end the program."""
    return [f'popup({_text(text)},"{TITLE}",False,True,blocking={blocking})', "halt"]


def question(text: str) -> list[str]:
    """Return a question. Continue is the answer yes; any other button ends the program."""
    return [f'popup({_text(text)},"{QUESTION}",False,False,blocking=True)']


def message(text: str, before_question: bool) -> list[str]:
    """Return a message to the operator.

    With ``before_question`` it is read first, because a question follows.
    """
    if before_question:
        return [f'popup({_text(text)},"{READ}",False,False,blocking=True)']
    return [f'popup({_text(text)},"{TITLE}",False,False,blocking=False)']


def kinematics_check(
    home: str, tip: FloatArray, expected: FloatArray, tolerance: float, text: str
) -> list[str]:
    """Return statements that end the program unless a point of the flange is where it is expected.

    Args:
        home: Name of the joints at which it is checked.
        tip: Point (4, 4) of the flange.
        expected: Expected pose (4, 4) in the controller's base.
        tolerance: Tolerance [m].
        text: Text that is shown before the program ends.
    """
    return [
        f"if point_dist(get_forward_kin({home},{pose(tip)}),{pose(expected)})>{format_real(tolerance, 6)}:",
        *ending(text),
        "end",
    ]


def movej(target: str, acceleration: float, speed: float) -> str:
    """Return a joint move to the data ``target``, to an exact stop.

    The speed [rad/s] is that of the leading axis.
    """
    return f"movej({target},a={format_real(acceleration, 4)},v={format_real(speed, 4)})"


def blends(track: MoveTable, stop: BoolArray) -> FloatArray:
    """Return blend radii (M,) [m] of moves, 0 at exact stops, rounded down to micrometres.

    NaN if there is no room for one though the move does not stop: UR's blends are lengths on the path, so a
    tool that rotates about its TCP has none.
    """
    distance = track.distance
    shorter = np.minimum(distance, np.append(distance[1:], np.inf))
    room = 1e-3 * np.minimum(track.max_zone, MAX_BLEND_FRACTION * shorter)
    radius = np.floor(room * 1e6 + 1e-6) * 1e-6
    return np.where(stop, 0.0, np.where(radius < MIN_BLEND_M, np.nan, radius))


def linear_moves(track: MoveTable, radius: FloatArray, frame: str) -> list[str]:
    """Return the text of all moves of a track in ``frame``: target, time, blend."""
    vectors = log_rotation(from_quaternion(track.quaternion))
    rows = zip(
        (1e-3 * track.position).tolist(),
        vectors.tolist(),
        track.duration.tolist(),
        radius.tolist(),
        strict=True,
    )
    return [
        f"movel(pose_trans({frame},{format_pose(position, turn)}),t={format_real(time, 5)},"
        f"r={format_real(r, 6)})"
        for position, turn, time, r in rows
    ]
