"""Parser of URScript: words of a line, then the one form that each statement may have.

All else is a fault with its line. Words are case-sensitive. Comments begin with # and have no meaning,
except for the head of a segment.
"""

import functools
import re
from collections.abc import Callable
from typing import Final, Literal

from planner.languages.urscript.reader import syntax_tree
from planner.languages.urscript.reader.functions import (
    awaits_arc,
    read_ending,
    read_function,
    read_switched_off_outputs,
)
from planner.languages.urscript.reader.words import (
    OUTPUT_WORDS,
    OUTPUTS_READ,
    Part,
    Rows,
    ScriptError,
    ScriptLine,
    ScriptWord,
    expect_lines,
    format_code,
    next_line,
    output_read,
    popup,
    positive_number,
    split_comment,
    switched_output,
)
from planner.programs.steps import TextFault

_SEGMENT: Final = re.compile(r"#\s*Segment\s+([\w/]+):.*", re.ASCII)
"""Comment at the start of a segment."""
_TITLES: Final[dict[tuple[str, bool], Literal["question", "read", "note"]]] = {
    ("Tandem asks", True): "question",
    ("Tandem tells", True): "read",
    ("Tandem", False): "note",
}
"""Kind of a popup by its title, and by whether it holds the program."""
_KILL: Final = re.compile(rf"kill\s+({syntax_tree.WATCHING}|{syntax_tree.WATCHING_ARC}((?:_\d+)?))")
"""Statement that ends a thread."""
_RUN_WATCH: Final = re.compile(rf"{syntax_tree.WATCHING}\s*=\s*run\s+{syntax_tree.WATCH}\s*\(\s*\)")
"""Statement that starts the thread that watches the other program."""
_RUN_ARC: Final = re.compile(
    rf"{syntax_tree.WATCHING_ARC}((?:_\d+)?)\s*=\s*run\s+{syntax_tree.WATCH_ARC}((?:_\d+)?)\s*\(\s*\)"
)
"""Statement that starts the thread of a torch."""
MAX_READ_SECONDS: Final = 3600.0
"""Maximum time [s] of a move or pause that a program may state."""
MAX_READ_WAIT_S: Final = 1e6
"""Maximum time [s] of a wait for the other program that a program may state."""


def _radius(words: ScriptLine) -> float:
    radius = words.number()
    if not 0.0 <= radius <= 1.0:
        raise ScriptError("type", f"r is {radius:g}; allowed: 0 to 1 (m)")
    return radius


def _popup(line: int, text: str, title: str, blocking: bool) -> syntax_tree.Statement:
    """Return a popup, whose kind follows from its title and from whether it holds the program."""
    kind = _TITLES.get((title, blocking))
    if kind is None:
        holding = "blocking" if blocking else "not blocking"
        raise ScriptError("syntax", f"a popup with the title {title!r}, {holding}: not one of these programs")
    return syntax_tree.Popup(line, kind, text)


def _thread(line: int, row: str) -> syntax_tree.Statement | None:
    """Return the statement that starts or ends a thread, None for other statements."""
    if match := _KILL.fullmatch(row):
        if match[1] == syntax_tree.WATCHING:
            return syntax_tree.WatchdogThread(line, False)
        return syntax_tree.ArcWatchdog(line, syntax_tree.WATCH_ARC + match[2], False)
    if _RUN_WATCH.fullmatch(row):
        return syntax_tree.WatchdogThread(line, True)
    if match := _RUN_ARC.fullmatch(row):
        thread = syntax_tree.WATCH_ARC + match[2]
        if match[1] != match[2]:
            raise ScriptError("syntax", f"{thread} is held by the variable of another thread")
        return syntax_tree.ArcWatchdog(line, thread, True)
    return None


_CALLS: Final[dict[str, tuple[Callable[..., syntax_tree.Statement], tuple[Part, ...]]]] = {
    "movel": (
        syntax_tree.ScriptLinearMove,
        (
            "pose_trans(",
            ScriptLine.name,
            ",",
            ScriptLine.pose,
            "),t=",
            positive_number(MAX_READ_SECONDS, "t"),
            ",r=",
            _radius,
        ),
    ),
    "movej": (
        syntax_tree.ScriptJointMove,
        (ScriptLine.name, ",a=", positive_number(100.0, "a"), ",v=", positive_number(10.0, "v")),
    ),
    "set_tcp": (syntax_tree.SetTcp, (ScriptLine.name,)),
    "set_payload": (
        syntax_tree.SetPayload,
        (positive_number(1000.0, "the mass"), ",", lambda words: words.numbers(3)),
    ),
    "sleep": (syntax_tree.SleepStatement, (positive_number(MAX_READ_SECONDS, "a pause"),)),
    "popup": (_popup, popup(error=False)),
    syntax_tree.CHECK: (syntax_tree.PartnerCheck, (ScriptLine.flag, ",", ScriptLine.flag)),
    syntax_tree.STAND: (syntax_tree.DwellMove, (positive_number(MAX_READ_SECONDS, "a move's time"),)),
    **{
        word: (
            functools.partial(syntax_tree.AwaitSignal, name=word),
            (ScriptLine.flag, ",", positive_number(MAX_READ_WAIT_S, "the longest wait")),
        )
        for word in (syntax_tree.AWAIT_LINE, syntax_tree.AWAIT_RUNNING)
    },
    **{word: (syntax_tree.SetOutput, switched_output(first)) for word, first in OUTPUT_WORDS.items()},
}
"""Calls by the function's name: the constructor of the statement, and the form of the arguments."""


class ScriptReader:
    """Reads one file and collects its `faults`."""

    def __init__(self, text: str, file: str) -> None:
        self.rows = text.split("\n")
        self.file = file
        self.faults: list[TextFault] = []

    def fault(self, line: int, kind: str, message: str) -> None:
        """Record a fault of a line (from 1) with the code ``urscript.KIND``."""
        self.faults.append(TextFault(line, 1, f"urscript.{kind}", message, self.file))

    def program(self) -> syntax_tree.ScriptProgram | None:
        """Return the file's program with all that could be read, None if it has no valid head.

        The order is: head, variables and functions, statements, end. After a fault, reading continues in the
        next line.
        """
        name = ""
        data: dict[str, syntax_tree.ScriptVariable] = {}
        body: list[syntax_tree.Statement] = []
        closed = False
        endings: dict[str, syntax_tree.EndingFunction | syntax_tree.ArcFunction] = {}
        rows = iter(enumerate(self.rows, 1))
        for line, row in rows:
            if len(row.rstrip()) > syntax_tree.LINE_LENGTH:
                self.fault(line, "line_length", f"{len(row)} characters; allowed: {syntax_tree.LINE_LENGTH}")
            code, comment = split_comment(row)
            try:
                if (segment := _SEGMENT.fullmatch(comment)) and not code and name and not closed:
                    body.append(syntax_tree.SegmentComment(line, segment[1]))
                if not code:
                    continue
                if closed:
                    raise ScriptError("syntax", f"{format_code(code)}: nothing may follow the program")
                words = ScriptLine(code)
                if not name:
                    name = _head(words)
                elif code == "end":
                    closed = True
                elif words.next_word in (ScriptWord("name", "def"), ScriptWord("name", "thread")):
                    if any(not isinstance(statement, syntax_tree.SegmentComment) for statement in body):
                        raise ScriptError("syntax", "a function or thread follows the first statement")
                    word, ending = read_function(line, words, rows)
                    if word in endings:
                        raise ScriptError(
                            "name_duplicate", f"{word} is defined in line {endings[word].line} already"
                        )
                    endings[word] = ending
                elif (thread_statement := _thread(line, code)) is not None:
                    body.append(thread_statement)
                elif code.startswith("if"):
                    body.append(self._branch(line, words, rows))
                elif words.words[1:2] == (ScriptWord("sign", "="),):
                    self._datum(line, words, data, body)
                else:
                    body.append(_call(line, words))
            except ScriptError as wrong:
                self.fault(line, wrong.kind, wrong.message)
                if not name:
                    return None
        if not name:
            self.fault(len(self.rows), "syntax", "the file has no program: expected def NAME():")
            return None
        if not closed:
            self.fault(len(self.rows), "syntax", "the program has no end")
        partner_functions = {
            word: definition
            for word, definition in endings.items()
            if isinstance(definition, syntax_tree.EndingFunction)
        }
        torches = {
            word: definition
            for word, definition in endings.items()
            if isinstance(definition, syntax_tree.ArcFunction)
        }
        return syntax_tree.ScriptProgram(self.file, name, data, tuple(body), partner_functions, torches)

    def _datum(
        self,
        line: int,
        words: ScriptLine,
        data: dict[str, syntax_tree.ScriptVariable],
        body: list[syntax_tree.Statement],
    ) -> None:
        """Read a variable with its value, and add it to ``data``.

        ``body`` has the statements so far: variables must precede all of them.

        Raises:
            ScriptError: The line has another form, or the variable has a value already or comes too late.
        """
        (name,) = words.values(ScriptLine.name, "=")
        _check_name(name)
        if name in data:
            raise ScriptError("name_duplicate", f"{name} has a value in line {data[name].line} already")
        if any(not isinstance(statement, syntax_tree.SegmentComment) for statement in body):
            raise ScriptError("syntax", f"{name} gets its value after the first statement")
        if words.next_word.kind == "text":
            variable = syntax_tree.ScriptVariable(line, "text", words.text())
        elif words.next_word.text == "p":
            variable = syntax_tree.ScriptVariable(line, "pose", words.pose())
        else:
            variable = syntax_tree.ScriptVariable(line, "joints", words.numbers(6))
        words.rest()
        data[name] = variable

    def _branch(
        self, line: int, words: ScriptLine, rows: Rows
    ) -> syntax_tree.PoseCheck | syntax_tree.OutputLowCheck:
        """Read an if: a check of an output or of the arm. Both show a text and end the program."""
        words.values("if")
        if words.next_word.text in OUTPUTS_READ:
            (number,) = words.rest(output_read, ":")
            switched_outputs, text = read_switched_off_outputs(rows, blocking=True)
            expect_lines(rows, "end")
            return syntax_tree.OutputLowCheck(line, number, switched_outputs, text)
        arm_check: tuple[Part, ...] = (ScriptLine.name, ",", ScriptLine.pose, "),", ScriptLine.pose)
        name, tip, position, tolerance = words.rest(
            "point_dist(get_forward_kin(", *arm_check, ")>", positive_number(1.0, "the distance"), ":"
        )
        text = read_ending(next_line(rows), rows, blocking=True)
        expect_lines(rows, "end")
        return syntax_tree.PoseCheck(line, name, tip, position, tolerance, text)


def _head(words: ScriptLine) -> str:
    """Read the head of the program and return its name."""
    (name,) = words.rest("def", ScriptLine.name, "():")
    _check_name(name)
    return str(name)


def _check_name(name: str) -> None:
    """Raise a ScriptError for the name of a program or variable that is too long or a word of URScript."""
    if len(name) > syntax_tree.NAME_LENGTH:
        raise ScriptError(
            "name_length", f"{name} has {len(name)} characters; allowed: {syntax_tree.NAME_LENGTH}"
        )
    if (
        name in syntax_tree.RESERVED
        or re.fullmatch(syntax_tree.ARC_FUNCTION, name)
        or re.fullmatch(syntax_tree.ARC_VARIABLE, name)
    ):
        raise ScriptError("name_reserved", f"{name} is a word of URScript; use another name")


def _call(line: int, words: ScriptLine) -> syntax_tree.Statement:
    """Read a statement that is a call of a function."""
    word = words.take("name", what="a statement")
    if awaits_arc(word):
        construct: Callable[..., syntax_tree.Statement] = functools.partial(syntax_tree.AwaitArc, name=word)
        parts: tuple[Part, ...] = (positive_number(MAX_READ_SECONDS, "the longest wait"),)
    elif word in _CALLS:
        construct, parts = _CALLS[word]
    else:
        raise ScriptError("syntax", f"{word}: not a statement of these programs")
    statement = construct(line, *words.values("(", *parts))
    words.rest(")")
    return statement
