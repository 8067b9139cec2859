"""URScript text to statements: words of a line, then the one form that each statement may have.

Whatever is not of such a form is a fault with its line. Numbers are plain or with an exponent,
smaller than a controller's largest. The functions and the thread of a program that meets another one
have one form each, but for an input, outputs and a text. Words count with their case. Comments begin
with # and say nothing, but for the head of a segment.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Literal, NoReturn

from planner.verify.programs.steps import LARGEST_NUMBER, Fault
from planner.verify.urscript.syntax_tree import (
    AWAIT_LINE,
    AWAIT_RUNNING,
    CHECK,
    LINE_LENGTH,
    NAME_LENGTH,
    RESERVED,
    STAND,
    TEXT_LENGTH,
    WATCH,
    WATCHING,
    Await,
    Begins,
    Check,
    Data,
    Ending,
    Joint,
    Look,
    Output,
    Pause,
    Popup,
    Program,
    SetPayload,
    SetTcp,
    Six,
    Stand,
    Statement,
    StaysLow,
    Straight,
    Watch,
)

_WORD: Final = re.compile(
    r"\s*(?:(?P<number>-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?(?![\w.]))|(?P<name>[A-Za-z_]\w*)"
    r'|(?P<text>"[^"\\]*")|(?P<sign>!=|==|[\[\]():,=>+]))',
    re.ASCII,
)
"""A word of a line: a number, a name, a text, or a sign."""
_SEGMENT: Final = re.compile(r"#\s*Segment\s+([\w/]+):.*", re.ASCII)
"""The comment with which a segment begins."""
_TITLES: Final[dict[tuple[str, bool], Literal["question", "read", "note"]]] = {
    ("Tandem asks", True): "question",
    ("Tandem tells", True): "read",
    ("Tandem", False): "note",
}
"""What a popup is by its title, and whether it holds the program."""
OUTPUT_WORDS: Final = {"set_standard_digital_out": 0, "set_configurable_digital_out": 8}
"""Functions that switch digital outputs, and the number of their first one here."""
_INPUTS: Final = {"get_standard_digital_in": 0, "get_configurable_digital_in": 8}
"""Those that read inputs."""
_OUTPUTS_READ: Final = {"get_standard_digital_out": 0, "get_configurable_digital_out": 8}
"""Those that read outputs."""
_OUTPUTS_EACH: Final = 8
"""How many outputs each of them has."""
MOST_SECONDS: Final = 3600.0
"""Longest move or pause that is read [s]."""
MOST_WAIT: Final = 1e6
"""Longest wait for the other program that is read [s]."""


class ScriptError(Exception):
    """A line is no statement. `kind` is a fault's code without the language."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind, self.message = kind, message


@dataclass(frozen=True, slots=True)
class Word:
    """`kind` number, name, text or sign, and the word as written."""

    kind: str
    text: str


class _Line:
    """The words of a line, taken one by one."""

    def __init__(self, code: str) -> None:
        self.words: list[Word] = []
        self.at, place = 0, 0
        code = code.rstrip()
        while place < len(code):
            found = _WORD.match(code, place)
            if found is None or found.lastgroup is None:
                raise ScriptError(
                    "syntax", f"{code[place : place + 20].strip()!r}: no word of these programs"
                )
            self.words.append(Word(found.lastgroup, found[found.lastgroup]))
            place = found.end()

    @property
    def next(self) -> Word:
        return self.words[self.at] if self.at < len(self.words) else Word("end", "the line's end")

    def fail(self, wanted: str) -> NoReturn:
        raise ScriptError("syntax", f"{self.next.text}: {wanted} must stand here")

    def take(self, kind: str, text: str = "", what: str = "") -> str:
        """The next word, which has to be of a kind, and if stated the very text."""
        word = self.next
        if word.kind != kind or (text and word.text != text):
            self.fail(what or (repr(text) if text else f"a {kind}"))
        self.at += 1
        return word.text

    def signs(self, *texts: str) -> None:
        for text in texts:
            self.take("name" if text[0].isalpha() else "sign", text)

    def number(self) -> float:
        text = self.take("number")
        value = float(text)
        if not abs(value) < LARGEST_NUMBER:
            raise ScriptError("number", f"{text:.40} is no number that a controller holds")
        return value or 0.0

    def above(self, least: float, most: float, what: str) -> float:
        """A number of a range, its lower end left out."""
        value = self.number()
        if not least < value <= most:
            raise ScriptError("type", f"{what} is {value:g}; allowed: above {least:g}, to {most:g}")
        return value

    def flag(self) -> bool:
        word = self.take("name", what="True or False")
        if word not in ("True", "False"):
            raise ScriptError("syntax", f"{word}: True or False must stand here")
        return word == "True"

    def text(self) -> str:
        text = self.take("text")[1:-1]
        if len(text) > TEXT_LENGTH:
            raise ScriptError("string_length", f"a text of {len(text)} characters; allowed: {TEXT_LENGTH}")
        return text

    def numbers(self, count: int) -> tuple[float, ...]:
        """A list of so many numbers."""
        self.take("sign", "[")
        out = [self.number()]
        while self.next.text == ",":
            self.take("sign", ",")
            out.append(self.number())
        self.take("sign", "]")
        if len(out) != count:
            raise ScriptError("type", f"a list of {len(out)} numbers; {count} are needed")
        return tuple(out)

    def pose(self) -> Six:
        self.take("name", "p", "a pose p[...]")
        x, y, z, rx, ry, rz = self.numbers(6)
        return x, y, z, rx, ry, rz

    def keyed(self, key: str) -> None:
        """A comma, the name of a parameter, and its sign."""
        self.take("sign", ",")
        self.take("name", key, f"the parameter {key}=")
        self.take("sign", "=")

    def done(self) -> None:
        if self.next.kind != "end":
            self.fail("nothing more")


def _movel(line: int, words: _Line) -> Statement:
    words.signs("pose_trans", "(")
    frame = words.take("name")
    words.signs(",")
    place = words.pose()
    words.signs(")")
    words.keyed("t")
    seconds = words.above(0.0, MOST_SECONDS, "t")
    words.keyed("r")
    radius = words.number()
    if not 0.0 <= radius <= 1.0:
        raise ScriptError("type", f"r is {radius:g}; allowed: 0 to 1 (m)")
    return Straight(line, frame, place, seconds, radius)


def _movej(line: int, words: _Line) -> Statement:
    name = words.take("name")
    words.keyed("a")
    acceleration = words.above(0.0, 100.0, "a")
    words.keyed("v")
    return Joint(line, name, acceleration, words.above(0.0, 10.0, "v"))


def _payload(line: int, words: _Line) -> Statement:
    mass = words.above(0.0, 1000.0, "the mass")
    words.signs(",")
    x, y, z = words.numbers(3)
    return SetPayload(line, mass, (x, y, z))


def _popup(line: int, words: _Line) -> Statement:
    text, title, blocking = _shown(words, error=False)
    kind = _TITLES.get((title, blocking))
    if kind is None:
        told = "blocking" if blocking else "not blocking"
        raise ScriptError("syntax", f"a popup with the title {title!r}, {told}: none of these programs")
    return Popup(line, kind, text)


def _shown(words: _Line, error: bool) -> tuple[str, str, bool]:
    """Text, title, and whether it holds the program, of a popup."""
    text = words.text()
    words.signs(",")
    title = words.text()
    words.signs(",", "False", ",", "True" if error else "False")
    words.keyed("blocking")
    return text, title, words.flag()


def _output(first: int) -> Callable[[int, _Line], Statement]:
    def read(line: int, words: _Line) -> Statement:
        text = words.take("number")
        if not text.isdigit() or int(text) >= _OUTPUTS_EACH:
            raise ScriptError("type", f"output {text}; allowed: whole numbers from 0 to {_OUTPUTS_EACH - 1}")
        words.signs(",")
        return Output(line, first + int(text), words.flag())

    return read


def _await(name: str) -> Callable[[int, _Line], Statement]:
    def read(line: int, words: _Line) -> Statement:
        value = words.flag()
        words.signs(",")
        return Await(line, name, value, words.above(0.0, MOST_WAIT, "the longest wait"))

    return read


def _check(line: int, words: _Line) -> Statement:
    value = words.flag()
    words.signs(",")
    return Check(line, value, words.flag())


def _kill(line: int, row: str) -> Statement | None:
    """The statement that begins or ends the thread, None for another one."""
    words = row.split()
    if words == ["kill", WATCHING]:
        return Watch(line, False)
    return Watch(line, True) if re.fullmatch(rf"{WATCHING}\s*=\s*run\s+{WATCH}\s*\(\s*\)", row) else None


_CALLS: Final[dict[str, Callable[[int, _Line], Statement]]] = {
    "movel": _movel,
    "movej": _movej,
    "set_tcp": lambda line, words: SetTcp(line, words.take("name")),
    "set_payload": _payload,
    "sleep": lambda line, words: Pause(line, words.above(0.0, MOST_SECONDS, "a pause")),
    "popup": _popup,
    CHECK: _check,
    STAND: lambda line, words: Stand(line, words.above(0.0, MOST_SECONDS, "a move's time")),
    **{word: _await(word) for word in (AWAIT_LINE, AWAIT_RUNNING)},
    **{word: _output(first) for word, first in OUTPUT_WORDS.items()},
}
"""Statements by the function that they call: its name and what reads its parameters."""


class Reader:
    """Reads one file; `faults` are filled meanwhile."""

    def __init__(self, text: str, file: str) -> None:
        self.rows = text.split("\n")
        self.file = file
        self.faults: list[Fault] = []

    def fault(self, line: int, kind: str, message: str) -> None:
        self.faults.append(Fault(line, 1, f"urscript.{kind}", message, self.file))

    def program(self) -> Program | None:
        """The file's program, None where it has no head."""
        name, data, body, ended = "", dict[str, Data](), list[Statement](), False
        endings: dict[str, Ending] = {}
        rows = iter(enumerate(self.rows, 1))
        for line, row in rows:
            if len(row.rstrip()) > LINE_LENGTH:
                self.fault(line, "line_length", f"{len(row)} characters; allowed: {LINE_LENGTH}")
            code, comment = parted(row)
            try:
                if (segment := _SEGMENT.fullmatch(comment)) and not code and name and not ended:
                    body.append(Begins(line, segment[1]))
                if not code:
                    continue
                if ended:
                    raise ScriptError("syntax", f"{_shown_code(code)}: nothing stands behind the program")
                words = _Line(code)
                if not name:
                    name = _head(words)
                elif code == "end":
                    ended = True
                elif words.next in (Word("name", "def"), Word("name", "thread")):
                    if any(not isinstance(statement, Begins) for statement in body):
                        raise ScriptError("syntax", "a function or thread stands behind the first statement")
                    word, ending = self._ending(line, words, rows)
                    if word in endings:
                        raise ScriptError(
                            "name_duplicate", f"{word} stands in line {endings[word].line} already"
                        )
                    endings[word] = ending
                elif (watch := _kill(line, code)) is not None:
                    body.append(watch)
                elif code.startswith("if"):
                    body.append(self._branch(line, words, rows))
                elif words.words[1:2] == [Word("sign", "=")]:
                    self._datum(line, words, data, body)
                else:
                    body.append(_call(line, words))
            except ScriptError as wrong:
                self.fault(line, wrong.kind, wrong.message)
                if not name:
                    return None
        if not name:
            self.fault(len(self.rows), "syntax", "the file has no program: def NAME(): must stand here")
            return None
        if not ended:
            self.fault(len(self.rows), "syntax", "the program has no end")
        return Program(self.file, name, data, tuple(body), endings)

    def _datum(self, line: int, words: _Line, data: dict[str, Data], body: list[Statement]) -> None:
        name = words.take("name")
        words.signs("=")
        _named(name)
        if name in data:
            raise ScriptError("name_duplicate", f"{name} has a value in line {data[name].line} already")
        if any(not isinstance(statement, Begins) for statement in body):
            raise ScriptError("syntax", f"{name} gets its value behind the first statement")
        if words.next.kind == "text":
            found = Data(line, "text", words.text())
        elif words.next.text == "p":
            found = Data(line, "pose", words.pose())
        else:
            found = Data(line, "joints", words.numbers(6))
        words.done()
        data[name] = found

    def _branch(self, line: int, words: _Line, rows: _Rows) -> Look | StaysLow:
        """The two branches there are: both show a text and end the program."""
        words.signs("if")
        if words.next.text in _OUTPUTS_READ:
            number = _numbered(words, _OUTPUTS_READ)
            words.signs(":")
            words.done()
            off, text = _switched_off(rows, blocking=True)
            _code(rows, "end")
            return StaysLow(line, number, off, text)
        words.signs("point_dist", "(", "get_forward_kin", "(")
        name = words.take("name")
        words.signs(",")
        tip = words.pose()
        words.signs(")", ",")
        place = words.pose()
        words.signs(")", ">")
        most = words.above(0.0, 1.0, "the distance")
        words.signs(":")
        words.done()
        text = _ended(rows, blocking=True)
        _code(rows, "end")
        return Look(line, name, tip, place, most, text)

    def _ending(self, line: int, words: _Line, rows: _Rows) -> tuple[str, Ending]:
        """A function that waits, or the thread that watches."""
        if words.next.text == "thread":
            words.signs("thread", WATCH, "(", ")", ":")
            words.done()
            head = _Line(_next_code(rows))
            head.signs("while")
            number = _numbered(head, _INPUTS)
            head.signs("and")
            own = _numbered(head, _OUTPUTS_READ)
            head.signs(":")
            head.done()
            _code(rows, "sync()")
            _code(rows, "end")
            off, text = _switched_off(rows, blocking=False)
            _code(rows, "end")
            return WATCH, Ending(line, (number,), own, off, text)
        words.signs("def")
        word = words.take("name")
        if word == STAND:
            words.signs("(", "seconds", ")", ":")
            words.done()
            _code(rows, "sleep(seconds)")
            _code(rows, "end")
            return STAND, Ending(line, (), -1, (), "")
        if word not in (AWAIT_LINE, AWAIT_RUNNING, CHECK):
            raise ScriptError("syntax", f"{word}: no function of these programs")
        words.signs("(", "level", ",", "own" if word == CHECK else "limit", ")", ":")
        words.done()
        if word == CHECK:
            numbers, own = _condition(rows, "if", "==", "False", "or", "!=", "own")
            off, text = _switched_off(rows, blocking=True)
            ends = ["end", "end"]
        else:
            _code(rows, "local passed=0.0")
            numbers, own = _condition(rows, "while", "==", "False")
            again = _Line(_next_code(rows))
            again.signs("if", "passed", ">", "limit", "or")
            if _numbered(again, _OUTPUTS_READ) != own:
                raise ScriptError("syntax", f"{word} looks at two outputs; it has one to look at")
            again.signs("==", "False", ":")
            again.done()
            off, text = _switched_off(rows, blocking=True)
            ends = ["end", f"sleep({WAIT_STEP})", f"passed=passed+{WAIT_STEP}", "end", "end"]
        for code in ends:
            _code(rows, code)
        return word, Ending(line, numbers, own, off, text)


_Rows = Iterator[tuple[int, str]]
"""Rows of a file that are still to be read, with their numbers."""
WAIT_STEP: Final = "0.01"
"""Time [s] between two looks of a wait, as it is written."""


def _next_code(rows: _Rows) -> str:
    return next((code for _, row in rows if (code := parted(row)[0])), "")


def _code(rows: _Rows, wanted: str) -> None:
    """The next line, which has to be this very one but for spaces."""
    code = _next_code(rows)
    if _Line(code).words != _Line(wanted).words:
        raise ScriptError("syntax", f"{_shown_code(code)}: {wanted} must stand here")


def _numbered(words: _Line, known: Mapping[str, int]) -> int:
    """The number of an input or output that one of these functions names."""
    word = words.take("name", what=" or ".join(known))
    if word not in known:
        raise ScriptError("syntax", f"{word}: {' or '.join(known)} must stand here")
    words.signs("(")
    text = words.take("number")
    if not text.isdigit() or int(text) >= _OUTPUTS_EACH:
        raise ScriptError("type", f"{word} of {text}; allowed: whole numbers from 0 to {_OUTPUTS_EACH - 1}")
    words.signs(")")
    return known[word] + int(text)


def _condition(rows: _Rows, word: str, *behind: str) -> tuple[tuple[int, ...], int]:
    """Inputs and the output of the head of a loop or branch: that an input is not the level asked for, with
    two of them that the second one is 0, or that an output is as ``behind`` says."""
    words = _Line(_next_code(rows))
    words.signs(word)
    numbers = [_numbered(words, _INPUTS)]
    words.signs("!=", "level", "or")
    if "or" in behind:
        numbers.append(_numbered(words, _INPUTS))
        words.signs(*behind[: behind.index("or") + 1])
        behind = behind[behind.index("or") + 1 :]
    own = _numbered(words, _OUTPUTS_READ)
    words.signs(*behind, ":")
    words.done()
    return tuple(numbers), own


def _switched_off(rows: _Rows, blocking: bool) -> tuple[tuple[int, ...], str]:
    """Outputs that are switched off, and the text that is shown before the program ends."""
    off: list[int] = []
    while True:
        words = _Line(_next_code(rows))
        if words.next.text not in OUTPUT_WORDS:
            return tuple(off), _ended(rows, blocking, words)
        statement = _call(0, words)
        if not isinstance(statement, Output) or statement.value:
            raise ScriptError("syntax", "outputs go off where the program ends")
        off.append(statement.number)


def _ended(rows: _Rows, blocking: bool, words: _Line | None = None) -> str:
    """The text of a popup, behind which the program ends."""
    inner = _Line(_next_code(rows)) if words is None else words
    inner.signs("popup", "(")
    text, title, holds = _shown(inner, error=True)
    inner.signs(")")
    inner.done()
    if holds != blocking or title != "Tandem":
        how = "hold the program" if blocking else "not hold the program"
        raise ScriptError("syntax", f"the popup before halt has to {how}")
    _code(rows, "halt")
    return text


def _head(words: _Line) -> str:
    words.signs("def")
    name = words.take("name")
    words.signs("(", ")", ":")
    words.done()
    _named(name)
    return name


def _named(name: str) -> None:
    if len(name) > NAME_LENGTH:
        raise ScriptError("name_length", f"{name} has {len(name)} characters; allowed: {NAME_LENGTH}")
    if name in RESERVED:
        raise ScriptError("name_reserved", f"{name} is a word of URScript; take another name")


def _call(line: int, words: _Line) -> Statement:
    word = words.take("name", what="a statement")
    read = _CALLS.get(word)
    if read is None:
        raise ScriptError("syntax", f"{word}: no statement of these programs")
    words.signs("(")
    out = read(line, words)
    words.signs(")")
    words.done()
    return out


def parted(row: str) -> tuple[str, str]:
    """A row's code and its comment; no text holds a quote, so that the first # outside of quotes begins
    it."""
    inside = False
    for i, letter in enumerate(row):
        if letter == '"':
            inside = not inside
        elif letter == "#" and not inside:
            return row[:i].strip(), row[i:].strip()
    return row.strip(), ""


def without_comments(content: str) -> list[str]:
    """The rows of a file without comments, white space around them, and empty rows."""
    return [code for row in content.split("\n") if (code := parted(row)[0])]


def _shown_code(code: str) -> str:
    return repr(code if len(code) <= 60 else code[:57] + "...") if code else "the file's end"
