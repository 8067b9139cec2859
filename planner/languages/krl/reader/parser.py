"""Parses one KRL file line by line. A line that has none of the forms in docs/krl.md is a fault.

A long program has thousands of moves and speeds; these lines are tried first, each with one expression.
"""

import re
from collections.abc import Callable, Iterator, Sequence

from planner.languages.krl.reader import syntax_tree, values
from planner.languages.krl.reader.panel import PANEL_FORMS, StatementForm, parse_variables
from planner.languages.krl.reader.values import UNSIGNED, KrlValueError
from planner.programs.steps import TextFault, to_singles

_NAME = r"[A-Za-z_]\w*"
_DECIMAL = r"(-?\d{1,9}\.\d{1,20})"
"""A number with decimals."""
_POSE = ",".join(f"{name} {_DECIMAL}" for name in "XYZABC")
"""Pattern of the six numbers of a target."""
_USUAL_MOVE = re.compile(
    rf"(S?LIN) \{{{_POSE}((?:,E[1-6] -?\d{{1,9}}\.\d{{1,20}})*)\}}(?: (C_(?:SPL|DIS|ORI)))?", re.ASCII
)
"""A straight move as the writer writes it. Programs have thousands of them, so it is tried first."""
_STRAIGHT_MOVE = re.compile(r"(S?LIN)\s*(\{.*\})\s*(C_SPL|C_DIS|C_ORI)?", re.IGNORECASE | re.ASCII)
"""A straight move in any valid form."""
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
"""Header lines of files, after an ampersand. They belong to the controller; programs do not see them."""
_MAX_LINE_LENGTH = 10 * syntax_tree.MAX_LINE_LENGTH
"""Maximum length of a line that is parsed [characters]; longer lines are refused anyway."""
_SEGMENT = re.compile(r"Segment (\S[^:]*):", re.ASCII)

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
"""Lines of a guarded wait: a wait for an input that halts on a timeout and then waits again."""
_SWITCHED_OFF = re.compile(r"\$OUT\[(\d{1,4})\]\s*=\s*FALSE", re.IGNORECASE | re.ASCII)
"""Statement of a guarded wait that switches an output off on a timeout."""
_STOP_ROWS = tuple(
    re.compile(row, re.IGNORECASE)
    for row in ("LOOP", "HALT", "ENDLOOP", "ENDIF", r"WAIT SEC 0\.01", "ENDWHILE", r"\$TIMER_STOP\[1\]=TRUE")
)
"""Last lines of a guarded wait that switches outputs off: after the timeout the program never resumes."""
_MAX_WAIT_MS = 2**31 - 1
"""Maximum timeout [ms]: the largest integer of KRL."""


def significant_lines(text: str) -> list[str]:
    """Return the content of a file that matters to the proof: lines of code, and marked comments."""
    out: list[str] = []
    for number, row in enumerate(text.split("\n"), 1):
        code, comment = split_comment(row.strip(" \t\r"))
        if code:
            out.append(code)
        out += [f"{statement.kind} {statement.text}" for statement in marked_comment(number, comment)]
    return out


class KrlFileParser:
    """Parser of one file, a program or a data list.

    Attributes:
        file: Path of the file.
        faults: Faults so far.
        rows: Lines of the file, without trailing blanks. Very long ones are emptied and not parsed.
        index: Index of the next line, from 0.
    """

    def __init__(self, text: str, file: str) -> None:
        self.file = file
        self.faults: list[TextFault] = []
        self.rows = [row.rstrip(" \t\r") for row in text.split("\n")]
        overlong = [n for n, row in enumerate(self.rows) if len(row) > _MAX_LINE_LENGTH]
        self.index = 0
        if self.rows and not self.rows[-1]:
            self.rows.pop()
        for number, row in enumerate(self.rows, 1):
            if len(row) > syntax_tree.MAX_LINE_LENGTH:
                message = (
                    f"the line has {len(row)} characters; allowed: {syntax_tree.MAX_LINE_LENGTH}; break it"
                )
                self.fault(number, "line_length", message)
        for n in overlong:
            self.rows[n] = ""

    def fault(self, line: int, kind: str, message: str) -> None:
        """Record a fault.

        Args:
            line: Line, from 1.
            kind: Issue code without the language.
            message: What is wrong.
        """
        self.faults.append(TextFault(max(line, 1), 1, f"krl.{kind}", message, self.file))

    # ---- .src ----

    def program(self) -> syntax_tree.KrlProgram | None:
        """Parse the file as a program, and record its faults. None if it does not start with DEF.

        A line with a fault is left out of the program. EXT and DECL must precede all statements.
        """
        self._header()
        name = self._frame(_DEF, "DEF name()")
        external: list[str] = []
        declared: list[tuple[str, str]] = []
        body: list[syntax_tree.KrlStatement] = []
        ended = False
        while self.index < len(self.rows):
            line, row = self.index + 1, self.rows[self.index].strip()
            self.index += 1
            if ended:
                if row and not row.startswith(";"):
                    self.fault(line, "syntax", f"{_shorten(row)} follows END")
                continue
            usual_move = _USUAL_MOVE.fullmatch(row)
            if usual_move is not None:
                word, *numbers, outer, corner = usual_move.groups()
                x, y, z, a, b, c = (to_singles(numbers) + 0.0).tolist()
                try:
                    axes = values.parse_external_axes(outer)
                except KrlValueError as wrong:
                    self.fault(line, wrong.kind, wrong.message)
                    continue
                body.append(syntax_tree.LinearStatement(line, word, (x, y, z, a, b, c), corner or "", axes))
                continue
            if not row or row.startswith(";"):
                body += marked_comment(line, row)
                continue
            code, text = split_comment(row)
            if code.upper() == "END":
                ended = True
            elif match := _EXT.fullmatch(code):
                if body and any(
                    not isinstance(statement, syntax_tree.CommentStatement) for statement in body
                ):
                    self.fault(line, "syntax", "EXT follows statements; it must follow DEF")
                if match[1].lower() == "bas":
                    self.fault(line, "syntax", "BAS has parameters: EXT BAS (BAS_COMMAND :IN,REAL :IN )")
                external.append(match[1].lower())
            elif _EXT_BAS.fullmatch(code) and not any(
                not isinstance(earlier, syntax_tree.CommentStatement) for earlier in body
            ):
                external.append("bas")
            elif (declarations := parse_variables(code)) and not any(
                not isinstance(earlier, syntax_tree.CommentStatement) for earlier in body
            ):
                declared += declarations
            else:
                statement = self._statement(line, code)
                if statement is not None:
                    body.append(statement)
                body += marked_comment(line, text)
        if not ended:
            self.fault(len(self.rows), "syntax", "END is missing")
        parts = (tuple(external), tuple(body), tuple(declared))
        return None if name is None else syntax_tree.KrlProgram(self.file, name, *parts)

    def _statement(self, line: int, code: str) -> syntax_tree.KrlStatement | None:
        """Parse the statement that starts in a line, and skip its further lines. None after a fault."""
        if _WAIT_GUARD[0].fullmatch(code):
            return self._guarded_wait(line)
        if values.SPLINE_START.fullmatch(code):
            return self._spline(line)
        for pattern, make in _STATEMENTS:
            match = pattern.fullmatch(code)
            if match is None:
                continue
            try:
                return make(line, match)
            except KrlValueError as wrong:
                self.fault(line, wrong.kind, wrong.message)
                return None
        if forms := [form for form in PANEL_FORMS if form.rows[0].fullmatch(code)]:
            return self._form(line, forms)
        self.fault(line, "syntax", f"{_shorten(code)}: not a statement of the supported subset")
        return None

    def _form(self, line: int, forms: list[StatementForm]) -> syntax_tree.KrlStatement | None:
        """Parse a statement that may have several forms, from ``line`` on; None after a fault.

        The form that matches the largest number of rows counts. It is a fault if a later row of it differs.
        """
        form, matches, end = max(
            ((form, *self._match_rows(line, form)) for form in forms), key=lambda candidate: len(candidate[1])
        )
        self.index = end
        if len(matches) < len(form.rows):
            row = self.rows[end].strip() if end < len(self.rows) else ""
            self.fault(end + 1, "syntax", f"{_shorten(row)}: not the next row of {form.what}")
            return None
        self._refuse_marked_comments(line, end, form.what)
        try:
            return form.build(line, matches)
        except KrlValueError as wrong:
            self.fault(line, wrong.kind, wrong.message)
            return None

    def _refuse_marked_comments(self, first: int, last: int, statement_name: str) -> None:
        """Record a fault for each marked comment in lines ``first`` to ``last`` of a statement."""
        for line in range(first, last + 1):
            if marked_comment(line, split_comment(self.rows[line - 1].strip())[1]):
                self.fault(line, "syntax", f"{statement_name} must not contain a marked comment")

    def _match_rows(self, line: int, form: StatementForm) -> tuple[list[re.Match[str]], int]:
        """Match the rows of a form with the file, from ``line`` on.

        Blank lines and comment lines are skipped.

        Returns:
            The matches up to the first row that differs, and the index, from 0, of the line that differs or
            follows the form.
        """
        matches: list[re.Match[str]] = []
        index = line - 1
        for pattern in form.rows:
            while index < len(self.rows) and (self.rows[index].strip() or ";").startswith(";"):
                index += 1
            code = split_comment(self.rows[index].strip())[0] if index < len(self.rows) else ""
            match = pattern.fullmatch(code)
            if match is None:
                break
            matches.append(match)
            index += 1
        return matches, index

    def _guarded_wait(self, line: int) -> syntax_tree.KrlStatement | None:
        """Parse a guarded wait whose first statement has been read; None after a fault.

        If it switches outputs off on a timeout, it is a wait for the process, which may show one message and
        then ends the program (`InputWait`). Otherwise it halts on a timeout and repeats the wait
        (`InputPoll`).
        """
        matches = self._match_wait_rows(_WAIT_GUARD[1:4])
        if matches is None:
            return None
        outputs_off: set[int] = set()
        while match := _SWITCHED_OFF.fullmatch(self._next_code()):
            outputs_off.add(int(match[1]))
            self.index += 1
        text = ""
        if outputs_off and (
            form := next((f for f in PANEL_FORMS if f.rows[0].fullmatch(self._next_code())), None)
        ):
            shown = self._form(self.index + 1, [form])
            if not isinstance(shown, syntax_tree.MessageStatement) or shown.state:
                self.fault(self.index, "syntax", "a guarded wait that times out shows at most one message")
                return None
            text = shown.text
        if self._match_wait_rows(_STOP_ROWS if outputs_off else _WAIT_GUARD[4:]) is None:
            return None
        self._refuse_marked_comments(line, self.index, "a guarded wait")
        number = int(matches[1][1])
        level = matches[1][2].upper() == "FALSE"  # the loop runs while the input has the other level
        timeout_ms = int(matches[2][1])
        if not 0 < timeout_ms <= _MAX_WAIT_MS:
            self.fault(line, "type", f"a wait of {timeout_ms} ms; allowed: 1 to {_MAX_WAIT_MS}")
        if outputs_off:
            return syntax_tree.InputWait(line, number, level, timeout_ms * 1e-3, frozenset(outputs_off), text)
        return syntax_tree.InputPoll(line, number, level, timeout_ms * 1e-3)

    def _next_code(self) -> str:
        """Skip blank lines and comments, and return the code of the next line, "" at the end of the file."""
        while self.index < len(self.rows) and (self.rows[self.index].strip() or ";").startswith(";"):
            self.index += 1
        return split_comment(self.rows[self.index].strip())[0] if self.index < len(self.rows) else ""

    def _match_wait_rows(self, patterns: Sequence[re.Pattern[str]]) -> list[re.Match[str]] | None:
        """Return the matches of the next lines of a guarded wait; None, with a fault, if one differs."""
        matches: list[re.Match[str]] = []
        for pattern in patterns:
            code = self._next_code()
            match = pattern.fullmatch(code)
            if match is None:
                message = f"{_shorten(code)}: not the next statement of a guarded wait, {pattern.pattern}"
                self.fault(self.index + 1, "syntax", message.replace("\\", ""))
                return None
            matches.append(match)
            self.index += 1
        return matches

    def _spline(self, line: int) -> syntax_tree.KrlStatement | None:
        """Parse a spline block whose SPLINE has been read. An invalid block is skipped up to its end."""
        try:
            return values.parse_block(line, self._remaining_rows())
        except values.SplineError as wrong:
            self.fault(wrong.line, wrong.kind, wrong.message)
        while self.index < len(self.rows) and not self.rows[self.index - 1].strip().upper().startswith(
            "ENDSPLINE"
        ):
            self.index += 1
        return None

    def _remaining_rows(self) -> Iterator[tuple[int, str, list[syntax_tree.CommentStatement]]]:
        """Yield the remaining lines: line number, code, and marked comments."""
        while self.index < len(self.rows):
            row = self.rows[self.index].strip()
            self.index += 1
            code, text = split_comment(row)
            yield self.index, code, marked_comment(self.index, text)

    # ---- .dat ----

    def data_list(self) -> syntax_tree.DataList | None:
        """Parse the file as a data list, and record its faults. None if it does not start with DEFDAT."""
        self._header()
        name = self._frame(_DEFDAT, "DEFDAT name PUBLIC")
        items: dict[str, syntax_tree.KrlDeclaration] = {}
        ended = False
        for line, row in self._lines():
            code = split_comment(row)[0]
            if ended:
                self.fault(line, "syntax", f"{_shorten(code)} follows ENDDAT")
            elif code.upper() == "ENDDAT":
                ended = True
            elif match := _DECL.fullmatch(code):
                self._declare(items, line, match[1].lower(), match[2], match[3])
            elif match := _CHAR.fullmatch(code):
                self._declare(items, line, "char", match[1], match[2])
            elif match := _TEXT.fullmatch(code):
                self._text(items, line, match[1], match[2])
            else:
                self.fault(line, "syntax", f"{_shorten(code)}: not a supported declaration")
        if not ended:
            self.fault(len(self.rows), "syntax", "ENDDAT is missing")
        for item in items.values():
            if item.kind == "char" and isinstance(item.value, int):
                self.fault(item.line, "no_value", f"{item.name} has no value; write {item.name}[]=...")
        return None if name is None else syntax_tree.DataList(self.file, name, items)

    def _declare(
        self, items: dict[str, syntax_tree.KrlDeclaration], line: int, kind: str, name: str, text: str
    ) -> None:
        """Add a declaration to ``items``, or record a fault.

        The value of a CHAR is its length, until a later line states its text.
        """
        self.check_name(line, name)
        if name.lower() in items:
            self.fault(
                line, "name_duplicate", f"{name} is already declared in line {items[name.lower()].line}"
            )
            return
        try:
            value = int(text) if kind == "char" else values.parse_value(kind, text)
        except KrlValueError as wrong:
            self.fault(line, wrong.kind, f"{name}: {wrong.message}")
            return
        items[name.lower()] = syntax_tree.KrlDeclaration(line, kind, name, value)

    def _text(self, items: dict[str, syntax_tree.KrlDeclaration], line: int, name: str, text: str) -> None:
        """Set the text of a CHAR that is already declared in ``items``."""
        item = items.get(name.lower())
        if item is None or item.kind != "char":
            self.fault(line, "undeclared", f"{name}[] is not declared as CHAR")
        elif not isinstance(item.value, int):
            self.fault(line, "name_duplicate", f"{name}[] has a value already")
        elif len(text) > item.value:
            self.fault(line, "type", f"{name}[] has {item.value} characters; got {len(text)}")
        else:
            items[name.lower()] = syntax_tree.KrlDeclaration(item.line, "char", item.name, text)

    # ---- .src and .dat ----

    def check_name(self, line: int, name: str) -> None:
        """Record faults of a name that the program declares: too long, or a reserved word.

        Args:
            line: Line, from 1.
            name: The name.
        """
        if len(name) > syntax_tree.MAX_NAME_LENGTH:
            self.fault(
                line,
                "name_length",
                f"{name} has {len(name)} characters; allowed: {syntax_tree.MAX_NAME_LENGTH}",
            )
        if name.lower() in syntax_tree.RESERVED:
            self.fault(line, "name_reserved", f"{name} is a reserved word of KRL; choose another name")

    def _header(self) -> None:
        """Skip the header lines of the controller, and check that &ACCESS is one of them."""
        words: list[str] = []
        while self.index < len(self.rows) and self.rows[self.index].lstrip().startswith("&"):
            row = self.rows[self.index].strip()
            self.index += 1
            word, _, parameters = row[1:].partition(" ")
            pattern = _FILE_HEAD.get(word.upper())
            if pattern is None or pattern.fullmatch(parameters.strip()) is None:
                self.fault(self.index, "syntax", f"{_shorten(row)}: not a supported header line")
            if word.upper() in words and word.upper() in ("ACCESS", "REL"):
                self.fault(self.index, "syntax", f"{_shorten(row)}: &{word.upper()} occurs twice")
            words.append(word.upper())
        if "ACCESS" not in words:
            self.fault(1, "syntax", "&ACCESS RVP is missing")

    def _frame(self, pattern: re.Pattern[str], expected: str) -> str | None:
        """Return the name in the first statement, DEF or DEFDAT; None, with a fault, for any other."""
        for line, row in self._lines():
            match = pattern.fullmatch(split_comment(row)[0])
            if match is None:
                self.fault(line, "syntax", f"{_shorten(row)}: expected {expected}")
                return None
            self.check_name(line, match[1])
            return match[1]
        self.fault(len(self.rows), "syntax", f"the file has no {expected}")
        return None

    def _lines(self) -> Iterator[tuple[int, str]]:
        """Yield the remaining lines that contain more than a comment: line number and text."""
        while self.index < len(self.rows):
            row = self.rows[self.index].strip()
            self.index += 1
            if row and not row.startswith(";"):
                yield self.index, row


def split_comment(row: str) -> tuple[str, str]:
    """Split a row into code and comment, which keeps its semicolon. A semicolon in a string is code."""
    in_string = False
    for i, letter in enumerate(row):
        in_string ^= letter == '"'
        if letter == ";" and not in_string:
            return row[:i].rstrip(), row[i:]
    return row, ""


def marked_comment(line: int, row: str) -> list[syntax_tree.CommentStatement]:
    """Return a marked comment, which the proof reads, as a statement. Other comments give an empty list.

    Args:
        line: Line, from 1.
        row: The comment with its semicolon.
    """
    if row.startswith(";*"):
        return [syntax_tree.CommentStatement(line, "told", row[2:].strip())]
    if row.startswith(";?"):
        return [syntax_tree.CommentStatement(line, "question", row[2:].strip())]
    match = _SEGMENT.match(row[1:].lstrip()) if row.startswith(";") else None
    return [syntax_tree.CommentStatement(line, "segment", match[1].strip().lower())] if match else []


def _shorten(row: str) -> str:
    return repr(row if len(row) <= 60 else row[:57] + "...")


def _setting(line: int, match: re.Match[str]) -> syntax_tree.KrlStatement:
    """Build a setting from its name and value.

    Raises `KrlValueError` if the setting is not supported, or if its value is not one of the allowed numbers
    or words. A frame setting may have any name, which is checked later against the data list.
    """
    name, value = match[1].lower(), match[2].lower()
    if name in syntax_tree.NUMBER_SETTINGS:
        low, high, integer_only = syntax_tree.NUMBER_SETTINGS[name]
        if _NUMBER.fullmatch(value) is None:
            raise KrlValueError("type", f"{match[1]} takes a number; got {value}")
        if not low <= float(value) <= high or (integer_only and float(value) != int(float(value))):
            kind = "whole numbers" if integer_only else "numbers"
            raise KrlValueError("type", f"{match[1]} is {value}; allowed: {kind} from {low:g} to {high:g}")
        return syntax_tree.SettingStatement(line, name, float(value))
    if name in syntax_tree.CHOICE_SETTINGS:
        if value not in syntax_tree.CHOICE_SETTINGS[name]:
            raise KrlValueError(
                "type", f"{match[1]} is {value}; allowed: {', '.join(syntax_tree.CHOICE_SETTINGS[name])}"
            )
        return syntax_tree.SettingStatement(line, name, value)
    if name in syntax_tree.FRAME_SETTINGS:
        return syntax_tree.SettingStatement(line, name, value)
    raise KrlValueError("syntax", f"{match[1]} is not a setting of the supported subset")


def _linear(line: int, match: re.Match[str]) -> syntax_tree.KrlStatement:
    target, outer = values.parse_target(match[2])
    return syntax_tree.LinearStatement(line, match[1].upper(), target, (match[3] or "").upper(), outer)


def _wait(line: int, match: re.Match[str]) -> syntax_tree.KrlStatement:
    values.parse_number("WAIT SEC", match[1])  # the time is used as written, but must be a number
    return syntax_tree.WaitSecStatement(line, float(match[1]))


def _output(line: int, match: re.Match[str]) -> syntax_tree.KrlStatement:
    return syntax_tree.OutputStatement(line, int(match[1]), match[2].upper() == "TRUE")


_STATEMENTS: tuple[tuple[re.Pattern[str], Callable[[int, re.Match[str]], syntax_tree.KrlStatement]], ...] = (
    (_OUT, _output),
    (_SET, _setting),
    (_STRAIGHT_MOVE, _linear),
    (_PTP, lambda line, match: syntax_tree.PtpStatement(line, match[1].lower())),
    (_WAIT, _wait),
    (
        re.compile(r"BAS\s*\(\s*#INITMOV\s*,\s*0\s*\)", re.IGNORECASE),
        lambda line, _: syntax_tree.InitMotion(line),
    ),
    (re.compile(r"HALT", re.IGNORECASE), lambda line, _: syntax_tree.HaltStatement(line)),
    (_CALL, lambda line, match: syntax_tree.CallStatement(line, match[1].lower())),
)
"""Patterns of the statements on one line, with the function that builds each from its match."""
