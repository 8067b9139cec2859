"""One KRL file to statements, line by line: a line that is none of the forms in docs/krl.md is a fault.

A long program has thousands of moves and speeds; those lines are tried first, each by one expression.
"""

import re
from collections.abc import Callable, Iterator, Sequence

from planner.languages.krl.reader import syntax_tree, values
from planner.languages.krl.reader.panel import PANEL_FORMS, Form, variables
from planner.languages.krl.reader.values import UNSIGNED, KrlValueError
from planner.programs.steps import Fault, singles

_NAME = r"[A-Za-z_]\w*"
_DECIMAL = r"(-?\d{1,9}\.\d{1,20})"
"""A number with decimals."""
_POSE = ",".join(f"{name} {_DECIMAL}" for name in "XYZABC")
"""The six figures of a target."""
_QUICK_MOVE = re.compile(
    rf"(S?LIN) \{{{_POSE}((?:,E[1-6] -?\d{{1,9}}\.\d{{1,20}})*)\}}(?: (C_(?:SPL|DIS|ORI)))?", re.ASCII
)
"""A straight move as programs have thousands of."""
_STRAIGHT_MOVE = re.compile(r"(S?LIN)\s*(\{.*\})\s*(C_SPL|C_DIS|C_ORI)?", re.IGNORECASE | re.ASCII)
"""Any straight move."""
_SET = re.compile(r"(\$[\w.]+(?:\[\d+\])?)\s*=\s*(#?[\w+.][\w.+-]*)", re.IGNORECASE | re.ASCII)
_NUMBER = re.compile(rf"\+?{UNSIGNED}", re.ASCII)
_OUT = re.compile(r"\$OUT\[(\d{1,4})\]\s*=\s*(TRUE|FALSE)", re.IGNORECASE | re.ASCII)
_PTP = re.compile(rf"PTP\s+({_NAME})", re.IGNORECASE | re.ASCII)
_WAIT = re.compile(rf"WAIT\s+SEC\s+(\+?{UNSIGNED})", re.IGNORECASE | re.ASCII)
_CALL = re.compile(rf"({_NAME})\s*\(\s*\)", re.ASCII)
_EXT = re.compile(rf"EXT\s+({_NAME})\s*\(\s*\)", re.IGNORECASE | re.ASCII)
_EXT_BAS = re.compile(
    r"EXT\s+BAS\s*\(\s*BAS_COMMAND\s*:\s*IN\s*,\s*REAL\s*:\s*IN\s*\)", re.IGNORECASE | re.ASCII
)
_DEF = re.compile(rf"DEF\s+({_NAME})\s*\(\s*\)", re.IGNORECASE | re.ASCII)
_DEFDAT = re.compile(rf"DEFDAT\s+({_NAME})\s+PUBLIC", re.IGNORECASE | re.ASCII)
_DECL = re.compile(
    rf"DECL\s+(FRAME|LOAD|E6POS|E6AXIS)\s+({_NAME})\s*=\s*(\{{.*\}})", re.IGNORECASE | re.ASCII
)
_CHAR = re.compile(rf"DECL\s+CHAR\s+({_NAME})\[(\d{{1,3}})\]", re.IGNORECASE | re.ASCII)
_TEXT = re.compile(rf'({_NAME})\[\s*\]\s*=\s*"([^"]*)"', re.ASCII)
_FILE_HEAD = {
    "ACCESS": re.compile(r"R?V?[PO]?\d{0,2}", re.ASCII),
    "REL": re.compile(r"\d{1,9}", re.ASCII),
    "COMMENT": re.compile(r".*"),
    "PARAM": re.compile(r"[A-Z]+\s*=.*", re.ASCII | re.IGNORECASE),
}
"""Lines that files begin with, behind an ampersand; the controller's own, of which programs see nothing."""
_LONGEST_LINE = 10 * syntax_tree.LINE_LENGTH
"""Longer lines are not read: they are refused anyway."""
_SEGMENT = re.compile(r"Segment (\S[^:]*):", re.ASCII)

# the guarded wait, statement by statement
_WAIT_GUARD = (
    re.compile(r"\$TIMER\[1\]=0", re.IGNORECASE),
    re.compile(r"\$TIMER_STOP\[1\]=FALSE", re.IGNORECASE),
    re.compile(r"WHILE \$IN\[(\d{1,4})\]==(TRUE|FALSE)", re.IGNORECASE | re.ASCII),
    re.compile(r"IF \$TIMER\[1\]>(\d{1,10}) THEN", re.IGNORECASE | re.ASCII),
    re.compile(r"HALT", re.IGNORECASE),
    re.compile(r"\$TIMER\[1\]=0", re.IGNORECASE),
    re.compile(r"ENDIF", re.IGNORECASE),
    re.compile(r"WAIT SEC 0\.01", re.IGNORECASE),
    re.compile(r"ENDWHILE", re.IGNORECASE),
    re.compile(r"\$TIMER_STOP\[1\]=TRUE", re.IGNORECASE),
)
"""Lines of a wait for an input that may last so long only."""
_SWITCHED_OFF = re.compile(r"\$OUT\[(\d{1,4})\]\s*=\s*FALSE", re.IGNORECASE | re.ASCII)
"""An output goes off where a wait has lasted too long."""
_ENDED = tuple(
    re.compile(row, re.IGNORECASE)
    for row in ("LOOP", "HALT", "ENDLOOP", "ENDIF", r"WAIT SEC 0\.01", "ENDWHILE", r"\$TIMER_STOP\[1\]=TRUE")
)
"""Lines behind that, in a wait behind which a program never goes on."""
_LONGEST_WAIT_MS = 2**31 - 1
"""Longest such wait [ms]: the largest whole number."""


def without_comments(text: str) -> list[str]:
    """What counts of a file, line by line: code without comments, and the comments that the proof reads."""
    out: list[str] = []
    for number, row in enumerate(text.split("\n"), 1):
        code, comment = parted(row.strip(" \t\r"))
        out += [code] if code else []
        out += [f"{one.kind} {one.text}" for one in marked_comment(number, comment)]
    return out


class Reader:
    """The lines of one file. `faults` is filled while it reads."""

    def __init__(self, text: str, file: str) -> None:
        self.file = file
        self.faults: list[Fault] = []
        self.rows = [row.rstrip(" \t\r") for row in text.split("\n")]
        long = [n for n, row in enumerate(self.rows) if len(row) > _LONGEST_LINE]
        self.at = 0
        if self.rows and not self.rows[-1]:
            self.rows.pop()
        for number, row in enumerate(self.rows, 1):
            if len(row) > syntax_tree.LINE_LENGTH:
                what = f"the line has {len(row)} characters; allowed: {syntax_tree.LINE_LENGTH}; break it"
                self.fault(number, "line_length", what)
        for n in long:
            self.rows[n] = ""

    def fault(self, line: int, kind: str, message: str) -> None:
        """Note a fault of the line."""
        self.faults.append(Fault(max(line, 1), 1, f"krl.{kind}", message, self.file))

    # ---- .src ----

    def program(self) -> syntax_tree.Program | None:
        """The file as a program, None where it has no frame."""
        self._head()
        name = self._frame(_DEF, "DEF name()")
        external: list[str] = []
        declared: list[tuple[str, str]] = []
        body: list[syntax_tree.Statement] = []
        ended = False
        while self.at < len(self.rows):
            line, row = self.at + 1, self.rows[self.at].strip()
            self.at += 1
            if ended:
                if row and not row.startswith(";"):
                    self.fault(line, "syntax", f"{_shown(row)} stands behind END")
                continue
            quick = _QUICK_MOVE.fullmatch(row)
            if quick is not None:
                word, *place, outer, corner = quick.groups()
                x, y, z, a, b, c = (singles(place) + 0.0).tolist()
                try:
                    axes = values.outer(outer)
                except KrlValueError as wrong:
                    self.fault(line, wrong.kind, wrong.message)
                    continue
                body.append(syntax_tree.Straight(line, word, (x, y, z, a, b, c), corner or "", axes))
                continue
            if not row or row.startswith(";"):
                body += marked_comment(line, row)
                continue
            code, text = parted(row)
            if code.upper() == "END":
                ended = True
            elif found := _EXT.fullmatch(code):
                if body and any(not isinstance(statement, syntax_tree.Said) for statement in body):
                    self.fault(line, "syntax", "EXT stands behind statements; it belongs right behind DEF")
                if found[1].lower() == "bas":
                    self.fault(line, "syntax", "BAS has parameters: EXT BAS (BAS_COMMAND :IN,REAL :IN )")
                external.append(found[1].lower())
            elif _EXT_BAS.fullmatch(code) and not any(not isinstance(one, syntax_tree.Said) for one in body):
                external.append("bas")
            elif (found_ := variables(code)) and not any(
                not isinstance(one, syntax_tree.Said) for one in body
            ):
                declared += found_
            else:
                statement = self._statement(line, code)
                body += [] if statement is None else [statement]
                body += marked_comment(line, text)
        if not ended:
            self.fault(len(self.rows), "syntax", "there is no END")
        parts = (tuple(external), tuple(body), tuple(declared))
        return None if name is None else syntax_tree.Program(self.file, name, *parts)

    def _statement(self, line: int, code: str) -> syntax_tree.Statement | None:
        if _WAIT_GUARD[0].fullmatch(code):
            return self._listen(line)
        if values.SPLINE_START.fullmatch(code):
            return self._spline(line)
        for pattern, make in _STATEMENTS:
            found = pattern.fullmatch(code)
            if found is None:
                continue
            try:
                return make(line, found)
            except KrlValueError as wrong:
                self.fault(line, wrong.kind, wrong.message)
                return None
        if forms := [form for form in PANEL_FORMS if form.rows[0].fullmatch(code)]:
            return self._form(line, forms)
        self.fault(line, "syntax", f"{_shown(code)}: no statement of the programs that are understood")
        return None

    def _form(self, line: int, forms: list[Form]) -> syntax_tree.Statement | None:
        """The one of the forms that goes on as the rows do from ``line`` on."""
        form, found, end = max(
            ((form, *self._found(line, form)) for form in forms), key=lambda one: len(one[1])
        )
        self.at = end
        if len(found) < len(form.rows):
            row = self.rows[end].strip() if end < len(self.rows) else ""
            self.fault(end + 1, "syntax", f"{_shown(row)}: not what comes next in {form.what}")
            return None
        self._quiet(line, end, form.what)
        try:
            return form.make(line, found)
        except KrlValueError as wrong:
            self.fault(line, wrong.kind, wrong.message)
            return None

    def _quiet(self, first: int, last: int, what: str) -> None:
        """Note comments that tell, ask or name a segment from row ``first`` to ``last`` of a form; what is
        behind its last statement counts."""
        for row in range(first, last + 1):
            if marked_comment(row, parted(self.rows[row - 1].strip())[1]):
                self.fault(row, "syntax", f"{what} tells and asks nothing of its own")

    def _found(self, line: int, form: Form) -> tuple[list[re.Match[str]], int]:
        """The rows of a form from ``line`` on, as far as they match, and the index of the row behind them."""
        found: list[re.Match[str]] = []
        at = line - 1
        for pattern in form.rows:
            while at < len(self.rows) and (self.rows[at].strip() or ";").startswith(";"):
                at += 1
            code = parted(self.rows[at].strip())[0] if at < len(self.rows) else ""
            match = pattern.fullmatch(code)
            if match is None:
                break
            found.append(match)
            at += 1
        return found, at

    def _listen(self, line: int) -> syntax_tree.Statement | None:
        """The guarded wait, whose first statement has been read."""
        found = self._guarded(_WAIT_GUARD[1:4])
        if found is None:
            return None
        off: set[int] = set()
        while match := _SWITCHED_OFF.fullmatch(self._next()):
            off.add(int(match[1]))
            self.at += 1
        text = ""
        if off and (form := next((f for f in PANEL_FORMS if f.rows[0].fullmatch(self._next())), None)):
            shown = self._form(self.at + 1, [form])
            if not isinstance(shown, syntax_tree.Notice) or shown.state:
                self.fault(self.at, "syntax", "a guarded wait that is over shows one message, or none")
                return None
            text = shown.text
        if self._guarded(_ENDED if off else _WAIT_GUARD[4:]) is None:
            return None
        self._quiet(line, self.at, "a guarded wait")
        number, level = int(found[1][1]), found[1][2].upper() == "FALSE"
        limit = int(found[2][1])
        if not 0 < limit <= _LONGEST_WAIT_MS:
            self.fault(line, "type", f"a wait of {limit} ms; allowed: 1 to {_LONGEST_WAIT_MS}")
        if off:
            return syntax_tree.Await(line, number, level, limit * 1e-3, frozenset(off), text)
        return syntax_tree.Listen(line, number, level, limit * 1e-3)

    def _next(self) -> str:
        """The code of the next row that has any; comments before it are passed over."""
        while self.at < len(self.rows) and (self.rows[self.at].strip() or ";").startswith(";"):
            self.at += 1
        return parted(self.rows[self.at].strip())[0] if self.at < len(self.rows) else ""

    def _guarded(self, patterns: Sequence[re.Pattern[str]]) -> list[re.Match[str]] | None:
        """The next rows of a guarded wait, None where one is another."""
        found: list[re.Match[str]] = []
        for pattern in patterns:
            code = self._next()
            match = pattern.fullmatch(code)
            if match is None:
                what = f"{_shown(code)}: not the next statement of a guarded wait, {pattern.pattern}"
                self.fault(self.at + 1, "syntax", what.replace("\\", ""))
                return None
            found.append(match)
            self.at += 1
        return found

    def _spline(self, line: int) -> syntax_tree.Statement | None:
        """The spline block whose SPLINE has been read; where it is none, the lines up to its end are passed
        over."""
        try:
            return values.block(line, self._behind())
        except values.SplineError as wrong:
            self.fault(wrong.line, wrong.kind, wrong.message)
        while self.at < len(self.rows) and not self.rows[self.at - 1].strip().upper().startswith("ENDSPLINE"):
            self.at += 1
        return None

    def _behind(self) -> Iterator[tuple[int, str, list[syntax_tree.Said]]]:
        """Rows from here on: line, code, and what is said there."""
        while self.at < len(self.rows):
            row = self.rows[self.at].strip()
            self.at += 1
            code, text = parted(row)
            yield self.at, code, marked_comment(self.at, text)

    # ---- .dat ----

    def data_list(self) -> syntax_tree.DataList | None:
        """The file as a data list, None where it has no frame."""
        self._head()
        name = self._frame(_DEFDAT, "DEFDAT name PUBLIC")
        items: dict[str, syntax_tree.Data] = {}
        ended = False
        for line, row in self._lines():
            code = parted(row)[0]
            if ended:
                self.fault(line, "syntax", f"{_shown(code)} stands behind ENDDAT")
            elif code.upper() == "ENDDAT":
                ended = True
            elif found := _DECL.fullmatch(code):
                self._declare(items, line, found[1].lower(), found[2], found[3])
            elif found := _CHAR.fullmatch(code):
                self._declare(items, line, "char", found[1], found[2])
            elif found := _TEXT.fullmatch(code):
                self._text(items, line, found[1], found[2])
            else:
                self.fault(line, "syntax", f"{_shown(code)}: no declaration that is understood")
        if not ended:
            self.fault(len(self.rows), "syntax", "there is no ENDDAT")
        for item in items.values():
            if item.kind == "char" and isinstance(item.value, int):
                self.fault(item.line, "no_value", f"{item.name} has no value; write {item.name}[]=...")
        return None if name is None else syntax_tree.DataList(self.file, name, items)

    def _declare(
        self, items: dict[str, syntax_tree.Data], line: int, kind: str, name: str, text: str
    ) -> None:
        self.name(line, name)
        if name.lower() in items:
            self.fault(line, "name_duplicate", f"{name} is declared in line {items[name.lower()].line} too")
            return
        try:
            value = int(text) if kind == "char" else values.value(kind, text)
        except KrlValueError as wrong:
            self.fault(line, wrong.kind, f"{name}: {wrong.message}")
            return
        items[name.lower()] = syntax_tree.Data(line, kind, name, value)

    def _text(self, items: dict[str, syntax_tree.Data], line: int, name: str, text: str) -> None:
        item = items.get(name.lower())
        if item is None or item.kind != "char":
            self.fault(line, "undeclared", f"{name}[] is not declared as CHAR")
        elif not isinstance(item.value, int):
            self.fault(line, "name_duplicate", f"{name}[] has a value already")
        elif len(text) > item.value:
            self.fault(line, "type", f"{name}[] has {item.value} characters; got {len(text)}")
        else:
            items[name.lower()] = syntax_tree.Data(item.line, "char", item.name, text)

    # ---- both ----

    def name(self, line: int, name: str) -> None:
        """Note what is wrong with a name of our own."""
        if len(name) > syntax_tree.NAME_LENGTH:
            self.fault(
                line, "name_length", f"{name} has {len(name)} characters; allowed: {syntax_tree.NAME_LENGTH}"
            )
        if name.lower() in syntax_tree.RESERVED:
            self.fault(line, "name_reserved", f"{name} is a word of KRL; take another name")

    def _head(self) -> None:
        found: list[str] = []
        while self.at < len(self.rows) and self.rows[self.at].lstrip().startswith("&"):
            row = self.rows[self.at].strip()
            self.at += 1
            word, _, rest = row[1:].partition(" ")
            pattern = _FILE_HEAD.get(word.upper())
            if pattern is None or pattern.fullmatch(rest.strip()) is None:
                self.fault(self.at, "syntax", f"{_shown(row)}: no header line that is understood")
            if word.upper() in found and word.upper() in ("ACCESS", "REL"):
                self.fault(self.at, "syntax", f"{_shown(row)}: &{word.upper()} stands twice")
            found.append(word.upper())
        if "ACCESS" not in found:
            self.fault(1, "syntax", "&ACCESS RVP must stand here")

    def _frame(self, pattern: re.Pattern[str], wanted: str) -> str | None:
        for line, row in self._lines():
            found = pattern.fullmatch(parted(row)[0])
            if found is None:
                self.fault(line, "syntax", f"{_shown(row)}: {wanted} must stand here")
                return None
            self.name(line, found[1])
            return found[1]
        self.fault(len(self.rows), "syntax", f"the file has no {wanted}")
        return None

    def _lines(self) -> Iterator[tuple[int, str]]:
        """Lines from here on that hold more than a comment, with their numbers."""
        while self.at < len(self.rows):
            row = self.rows[self.at].strip()
            self.at += 1
            if row and not row.startswith(";"):
                yield self.at, row


def parted(row: str) -> tuple[str, str]:
    """A row's code and its comment; no statement that is understood in .src files holds a string."""
    inside = False
    for i, letter in enumerate(row):
        inside ^= letter == '"'
        if letter == ";" and not inside:
            return row[:i].rstrip(), row[i:]
    return row, ""


def marked_comment(line: int, row: str) -> list[syntax_tree.Said]:
    """What a comment says to the proof; comments without one of the marks say nothing."""
    if row.startswith(";*"):
        return [syntax_tree.Said(line, "told", row[2:].strip())]
    if row.startswith(";?"):
        return [syntax_tree.Said(line, "question", row[2:].strip())]
    found = _SEGMENT.match(row[1:].lstrip()) if row.startswith(";") else None
    return [syntax_tree.Said(line, "segment", found[1].strip().lower())] if found else []


def _shown(row: str) -> str:
    return repr(row if len(row) <= 60 else row[:57] + "...")


def _set(line: int, found: re.Match[str]) -> syntax_tree.Statement:
    name, word = found[1].lower(), found[2].lower()
    if name in syntax_tree.NUMBER_SETTINGS:
        low, high, whole = syntax_tree.NUMBER_SETTINGS[name]
        if _NUMBER.fullmatch(word) is None:
            raise KrlValueError("type", f"{found[1]} takes a number; got {word}")
        if not low <= float(word) <= high or (whole and float(word) != int(float(word))):
            kind = "whole numbers" if whole else "numbers"
            raise KrlValueError("type", f"{found[1]} is {word}; allowed: {kind} from {low:g} to {high:g}")
        return syntax_tree.Set(line, name, float(word))
    if name in syntax_tree.CHOICE_SETTINGS:
        if word not in syntax_tree.CHOICE_SETTINGS[name]:
            raise KrlValueError(
                "type", f"{found[1]} is {word}; allowed: {', '.join(syntax_tree.CHOICE_SETTINGS[name])}"
            )
        return syntax_tree.Set(line, name, word)
    if name in syntax_tree.FRAME_SETTINGS:
        return syntax_tree.Set(line, name, word)
    raise KrlValueError("syntax", f"{found[1]} is no setting that these programs may make")


def _straight(line: int, found: re.Match[str]) -> syntax_tree.Statement:
    place, outer = values.place(found[2])
    return syntax_tree.Straight(line, found[1].upper(), place, (found[3] or "").upper(), outer)


def _pause(line: int, found: re.Match[str]) -> syntax_tree.Statement:
    values.number("WAIT SEC", found[1])  # the time counts as written, but has to be a number
    return syntax_tree.Pause(line, float(found[1]))


def _output(line: int, found: re.Match[str]) -> syntax_tree.Statement:
    return syntax_tree.Output(line, int(found[1]), found[2].upper() == "TRUE")


_STATEMENTS: tuple[tuple[re.Pattern[str], Callable[[int, re.Match[str]], syntax_tree.Statement]], ...] = (
    (_OUT, _output),
    (_SET, _set),
    (_STRAIGHT_MOVE, _straight),
    (_PTP, lambda line, found: syntax_tree.Joint(line, found[1].lower())),
    (_WAIT, _pause),
    (re.compile(r"BAS\s*\(\s*#INITMOV\s*,\s*0\s*\)", re.IGNORECASE), lambda line, _: syntax_tree.Start(line)),
    (re.compile(r"HALT", re.IGNORECASE), lambda line, _: syntax_tree.Halt(line)),
    (_CALL, lambda line, found: syntax_tree.Call(line, found[1].lower())),
)
"""Statements by their form, with what reads them."""
