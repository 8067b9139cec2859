"""Formats URScript: numbers, poses, straight moves, digital outputs, functions and popups.

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
"""Decimals of positions in m; targets have 4 decimals in mm."""
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

It is below 0.5, so that adjacent blends do not touch: a controller skips a waypoint whose blend meets the
next one.
"""
TEXT_LENGTH: Final = 255
"""Maximum length [characters] of a popup's text."""
AWAIT_LINE, AWAIT_RUNNING = "await_line", "await_running"
"""Names of the functions that wait for the other controller's line, and for its running wire."""
CHECK = "check_partner"
"""Name of the function that checks line and running wire of the other controller at one instant."""
STAND = "stand"
"""Name of the function that replaces a move in which only the other arm moves."""
WATCH, WATCHING = "watch_partner", "watching"
"""Names of the thread that ends the program when the other one stops, and of its variable."""
WAIT_STEP: Final = 0.01
"""Time [s] between two checks of a wait."""
SETTLING_TIME_S: Final = 0.1
"""Time [s] that a program waits after the rise of its running wire, so that it reads back the new level."""
START_PAUSE_S: Final = 1.0
"""Time [s] that a starting program waits before its running wire rises.

Meanwhile the other program notices that this one was stopped, if it still runs.
"""
TITLE, QUESTION, READ = "Tandem", "Tandem asks", "Tandem tells"
"""Titles of popups: of a text while the program continues, of a question, and of a text before a question."""

_RESERVED_TEXT: Final = """
and break continue def elif else end false for global halt if in local not or return sec thread true while
xor join kill run enter_critical exit_critical struct movej movel movep movec servoj speedj speedl stopj stopl
sleep sync popup textmsg pose_trans pose_inv point_dist get_forward_kin get_inverse_kin set_tcp set_payload
base_frame problem_digest await_line await_running check_partner watch_partner watching passed level limit own
stand seconds arc_lost arc_stood arc_place get_actual_tcp_pose
"""
RESERVED: Final = frozenset(_RESERVED_TEXT.split())
"""Words of the language and of its functions, which no name may be."""
ARC_NAMES: Final = r"(await|watch|watching)_arc(_\d+)?"
"""Pattern of the names of functions, threads and variables of torches, which no other name may be."""


def identifier(text: str, length: int = NAME_LENGTH) -> str:
    """Return an identifier made from text: lower-case letters, digits and single underscores.

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
    """Return text as comment lines, wrapped at 100 characters."""
    return [f"# {line}" for line in textwrap.wrap(to_ascii(text), 100)]


def pose(matrix: FloatArray) -> str:
    """Format a pose (4, 4) [m]."""
    rotation_vector = log_rotation(matrix[None, :3, :3])[0]
    return format_pose(matrix[:3, 3], rotation_vector)


def format_pose(position: Sequence[float] | FloatArray, vector: Sequence[float] | FloatArray) -> str:
    """Format a pose of a position (3,) [m] and a rotation vector (3,) [rad]."""
    values = [
        *(format_fixed(value, METRE_DECIMALS) for value in position),
        *(format_fixed(value, RADIAN_DECIMALS) for value in vector),
    ]
    return f"p[{','.join(values)}]"


def format_joints(q: FloatArray) -> str:
    """Format joints (6,) [rad] as the controller counts them."""
    return f"[{','.join(format_fixed(angle, RADIAN_DECIMALS) for angle in q)}]"


def format_real(value: float, decimals: int) -> str:
    """Format a number with a decimal point and without trailing zeros."""
    text = format_short(value, decimals)
    return text if "." in text else f"{text}.0"


def format_vector(values: FloatArray, decimals: int) -> str:
    """Format a list of numbers with at most ``decimals`` decimals."""
    return f"[{','.join(format_fixed(value, decimals) for value in values)}]"


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
    """Return the lines of a function that waits until an input has a level.

    When the time is over, or the running wire is low, it switches outputs off, shows a text and ends the
    program.

    Args:
        word: Name of the function.
        number: Number of the input.
        running: Number of the running wire's output.
        off_statements: Statements that switch the outputs off.
        text: Text before the end.
    """
    running_level = output_call(running)
    return [
        f"def {word}(level,limit):",
        "local passed=0.0",
        f"while {input_call(number)}!=level or {running_level}==False:",
        f"if passed>limit or {running_level}==False:",
        *off_statements,
        *end_program(text),
        "end",
        f"sleep({WAIT_STEP})",
        f"passed=passed+{WAIT_STEP}",
        "end",
        "end",
    ]


def check_function(line: int, runs: int, running: int, off_statements: Sequence[str], text: str) -> list[str]:
    """Return the lines of a function that ends the program unless the other program is as expected.

    It switches outputs off, shows a text and ends the program unless the input ``line`` has the level that a
    call states, the input ``runs`` is high, and the output ``running`` has the level ``own`` of the call.
    """
    unexpected = f"{input_call(line)}!=level or {input_call(runs)}==False or {output_call(running)}!=own"
    return [
        f"def {CHECK}(level,own):",
        f"if {unexpected}:",
        *off_statements,
        *end_program(text),
        "end",
        "end",
    ]


def watch_thread(number: int, running: int, off_statements: Sequence[str], text: str) -> list[str]:
    """Return the lines of the thread that checks the input ``number`` and output ``running`` in each cycle.

    When one falls, it executes ``off_statements``, shows ``text`` without a wait, and ends the program.
    """
    return [
        f"thread {WATCH}():",
        f"while {input_call(number)} and {output_call(running)}:",
        "sync()",
        "end",
        *off_statements,
        *end_program(text, blocking=False),
        "end",
    ]


def stand_function() -> list[str]:
    """Return the lines of the function that waits in place of a move of zero length.

    No manual states how a controller executes a movel of zero length.
    """
    return [f"def {STAND}(seconds):", "sleep(seconds)", "end"]


def stationary_moves(track: MoveTable, start_joints: FloatArray) -> BoolArray:
    """Return which moves (M,) of an operation have zero length as they are written.

    In such a move only the other arm moves. The first move is compared by joints, because the pose before it
    is not among the moves.

    Args:
        track: The moves.
        start_joints: Joints before the first move, (6,) [rad].
    """
    same_orientation = np.all(np.round(np.diff(track.quaternion, axis=0), RADIAN_DECIMALS) == 0.0, axis=1)
    at_start = np.abs(track.q[:1] - start_joints).max(axis=1) < 1e-9
    return np.asarray((track.distance == 0.0) & np.concatenate([at_start, same_orientation]))


def low_check(number: int, off_statement: str, text: str) -> list[str]:
    """Return statements that end the program if the output ``number`` is already on.

    They run before the program has switched anything. The output is switched off before the text is shown: a
    running wire that is high would tell the other program that this one runs.
    """
    return [f"if {output_call(number)}:", off_statement, *end_program(text), "end"]


def wait_call(word: str, value: int, seconds: float) -> str:
    """Return a call of the function ``word`` that waits up to ``seconds`` [s] for the level ``value``."""
    return f"{word}({'True' if value else 'False'},{format_real(seconds, 3)})"


def partner_check(value: int, running: bool) -> str:
    """Return a call that checks the other program's line, its running wire, and the own one (``running``)."""
    return f"{CHECK}({'True' if value else 'False'},{running})"


def _text(text: str) -> str:
    """Return a text in quotes.

    Raises:
        TandemError: No popup can show the text (``post.name``).
    """
    flat = to_ascii(text)
    if '"' in flat or "\\" in flat or len(flat) > TEXT_LENGTH:
        shown = f"a text of {len(flat)} characters" if len(flat) > TEXT_LENGTH else repr(flat)
        what = f"a popup of a UR controller cannot show {shown}"
        hint = f"give shorter names, without quotes and backslashes; allowed: {TEXT_LENGTH} characters"
        raise issue_error("post.name", what, hint=hint)
    return f'"{flat}"'


def end_program(text: str, blocking: bool = True) -> list[str]:
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
        tip: The point as a pose in the flange frame, (4, 4) [m].
        expected: Its expected pose in the controller's base frame, (4, 4) [m].
        tolerance: Tolerance [m].
        text: Text that is shown before the program ends.
    """
    return [
        f"if point_dist(get_forward_kin({home},{pose(tip)}),{pose(expected)})>{format_real(tolerance, 6)}:",
        *end_program(text),
        "end",
    ]


def movej(target: str, acceleration: float, speed: float) -> str:
    """Return a joint move to the joints variable ``target`` that ends in an exact stop.

    Acceleration [rad/s^2] and speed [rad/s] are those of the leading axis.
    """
    return f"movej({target},a={format_real(acceleration, 4)},v={format_real(speed, 4)})"


def blends(track: MoveTable, stop: BoolArray) -> FloatArray:
    """Return the blend radii of moves, rounded down to micrometres.

    Args:
        track: Moves of one operation, M of them.
        stop: Whether each move ends in a stop, (M,).

    Returns:
        Radii (M,) [m]: 0 at a stop, NaN where a move does not stop but leaves no length for a blend. A blend
        of UR is a length on the path, so that a tool that rotates about its TCP leaves none.
    """
    distance = track.distance
    shorter = np.minimum(distance, np.append(distance[1:], np.inf))  # of the moves before and after a target
    max_radius = 1e-3 * np.minimum(track.max_zone, MAX_BLEND_FRACTION * shorter)
    # 1e-6 micrometres keep a whole number that rounding has lowered slightly
    radius = np.floor(max_radius * 1e6 + 1e-6) * 1e-6
    return np.where(stop, 0.0, np.where(radius < MIN_BLEND_M, np.nan, radius))


def linear_moves(track: MoveTable, radius: FloatArray, frame: str) -> list[str]:
    """Return the statement of each move of an operation: target, time and blend radius.

    Args:
        track: Moves of the operation, M of them.
        radius: Blend radii, (M,) [m].
        frame: Pose variable with the frame of the targets.
    """
    vectors = log_rotation(from_quaternion(track.quaternion))
    moves = zip(
        (1e-3 * track.position).tolist(),
        vectors.tolist(),
        track.duration.tolist(),
        radius.tolist(),
        strict=True,
    )
    return [
        f"movel(pose_trans({frame},{format_pose(position, vector)}),t={format_real(time, 5)},"
        f"r={format_real(blend, 6)})"
        for position, vector, time, blend in moves
    ]
