"""Questions, messages and checks of one KRL program, and the order in which they may occur.

These statements are recognised only as fixed sequences of rows. Each row of a form is compared word by word,
ignoring blanks and case; any other row in it is a fault. A dialog continues only by its first key: the
surrounding loop repeats it for any other key, and if the controller cannot show it.

Then their order is checked, whatever is between them. A question is reliable if only the operator can answer
it: a dialog (krc4), or HALT in a mode of operation in which no PLC starts programs (krc2), which the next
statement ensures.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from planner.claims import sentences
from planner.languages.krl import sentences as krl_sentences
from planner.languages.krl.reader import syntax_tree
from planner.languages.krl.reader.values import KrlValueError
from planner.programs.steps import normalised_text

_EXTERNAL_REASON = "in automatic external a PLC that starts the program again answers it"
"""Reason against questions in automatic external."""


class PanelError(Exception):
    """A statement is not allowed at its position."""


class PanelMessage(NamedTuple):
    """A message or question that a statement shows to the operator.

    Attributes:
        kind: Word of the statement, such as HALT or #NOTIFY.
        text: The text.
        confirm: Whether it is a question.
        panel: "line" if it stays on the panel as a line, "clear" if it clears the panel, else "".
    """

    kind: str
    text: str
    confirm: bool = False
    panel: Literal["line", "clear", ""] = ""


class OperatorPanel:
    """State of the operator panel while a program is executed statement by statement.

    Attributes:
        dialect: KRL dialect.
        arm: Name of the program's arm.
        others: Names of the arms that it may wait for.
        axis_directions: Directions in $WORLD of the external axes that move the arm, by column.
        robroot_checked: Whether the program has checked that the robot's foot is where it was planned.
        prepared: Whether the options of messages, tm_opt, are set.
    """

    def __init__(
        self,
        dialect: str,
        arm: str,
        others: Sequence[str],
        axis_directions: Mapping[int, tuple[float, float, float]] | None = None,
    ) -> None:
        self.dialect, self.arm, self.others = dialect, arm, others
        self.axis_directions = dict(axis_directions or {})
        self.robroot_checked = False
        self._question: list[str] = []
        """Texts of a question that the program has begun to show, but not asked yet."""
        self._reading = False
        """Whether a text with the key Read has been shown, so that a question must follow."""
        self._open = False
        """krc2: whether the last HALT asked a question, so that automatic external must be refused next."""
        self._external = False
        """krc2: whether the program has refused to run in automatic external at least once."""
        self.prepared = False
        self._shown = ""
        """State that the panel shows until it is cleared, "" for none."""
        self._waited = False
        """Whether the program has waited for the other arm while this state was shown."""
        self._shown_before = ""
        """Normalised text of the notes shown directly before the current statement."""

    def check(self, statement: syntax_tree.KrlStatement | None, depth: int) -> None:
        """Check that a statement, or the program's end (None), may come next.

        Four things restrict the next statement:

        - A question that the program has begun to show: a dialog (krc4) or HALT (krc2) must follow.
        - A text with the key Read: a dialog must follow.
        - A HALT that asked a question (krc2): the refusal of automatic external must follow.
        - A state that the panel shows, in the main program: only a wait for an input, a call, or the end of
          the state may follow.

        Args:
            statement: The statement; comments may come anywhere.
            depth: Number of nested subprogram calls, 0 in the main program.

        Raises:
            PanelError: The statement may not come next.
        """
        if isinstance(statement, syntax_tree.CommentStatement):
            return
        answer: type[syntax_tree.KrlStatement] = (
            syntax_tree.DialogStatement if self.dialect == "krc4" else syntax_tree.HaltStatement
        )
        if self._question and not isinstance(statement, answer):
            required = "dialog with the key Yes" if answer is syntax_tree.DialogStatement else "HALT"
            raise PanelError(f"the question is not followed by a {required}")
        if self._reading and not isinstance(statement, syntax_tree.DialogStatement):
            raise PanelError("a text with the key Read is not followed by a question")
        if self._open and not isinstance(statement, syntax_tree.ExternalModeRefusal):
            raise PanelError(
                f"HALT alone is no question: {_EXTERNAL_REASON}; refuse that mode right after it"
            )
        if (
            self._shown
            and depth == 0
            and not isinstance(
                statement, syntax_tree.InputPoll | syntax_tree.CallStatement | syntax_tree.ClearState
            )
        ):
            raise PanelError(f"the panel still shows {self._shown!r} here, which is not true")

    def may_stop(self, statement: syntax_tree.KrlStatement) -> bool:
        """Return whether the program may halt at the statement without having asked a question.

        The outputs must be off at such a statement. It is a HALT of krc4, a check of the robot's foot or of
        an external axis, or a refusal of automatic external that does not belong to the question before it.
        """
        is_plain_halt = isinstance(statement, syntax_tree.HaltStatement) and self.dialect == "krc4"
        return (
            is_plain_halt
            or isinstance(statement, syntax_tree.RobrootCheck | syntax_tree.ExternalAxisCheck)
            or (isinstance(statement, syntax_tree.ExternalModeRefusal) and not self._open)
        )

    def take(self, statement: syntax_tree.KrlStatement, depth: int) -> PanelMessage | None:
        """Update the state by a statement, and return the message that it shows, or None.

        Args:
            statement: The statement.
            depth: Number of nested subprogram calls, 0 in the main program.

        Raises:
            PanelError: The statement is not allowed here.
        """
        message = self._take(statement, depth)
        if not isinstance(statement, syntax_tree.CommentStatement):
            if message is not None and message.kind == "#NOTIFY":
                self._shown_before += normalised_text(message.text)
            if not isinstance(statement, syntax_tree.MessageStatement):
                self._shown_before = ""
        return message

    def _take(self, statement: syntax_tree.KrlStatement, depth: int) -> PanelMessage | None:
        """Update the state by the kind of the statement, and return the message that it shows, or None.

        The caller updates ``_shown_before``.
        """
        match statement:
            case syntax_tree.CommentStatement(kind="question", text=text) if self.dialect == "krc2":
                self._require_main(depth, "a question (;?)")
                self._question.append(text)
            case syntax_tree.CommentStatement(kind="told", text=text) if self.dialect == "krc2":
                return PanelMessage(";*", text, panel="line")
            case syntax_tree.HaltStatement():
                return self._halt(depth)
            case syntax_tree.ExternalModeRefusal():
                self._require_main(depth, "the refusal of automatic external")
                # krc2 refuses this mode at the start, and later only directly after the HALT of a question
                if self.dialect == "krc4" or (self._external and not self._open):
                    raise PanelError(
                        "automatic external is refused where no question is asked; HALT stops there"
                    )
                self._external, self._open = True, False
            case syntax_tree.MessageOptions():
                self._require_krc4("messages")
                self.prepared = True
            case syntax_tree.DialogStatement(text=text, key=key):
                self._require_options(depth, "a dialog")
                return self._dialog(text, key)
            case syntax_tree.MessageStatement(text=text, state=False):
                self._require_options(depth, "a message")
                return PanelMessage("#NOTIFY", text, panel="line")
            case syntax_tree.MessageStatement(text=text):
                self._require_options(depth, "a message")
                return self._state(text)
            case syntax_tree.ClearState():
                if not self._shown or not self._waited:
                    raise PanelError("a state is cleared that is not shown, or without a wait")
                self._shown = ""
            case syntax_tree.InputPoll() if self.dialect == "krc4":
                self._poll(depth)
            case syntax_tree.RobrootCheck():
                self._require_main(depth, "the check of $ROBROOT")
                self._robroot(statement)
            case syntax_tree.ExternalAxisCheck(text=text):
                self._require_main(depth, "the check of an external axis")
                if bool(text) != (self.dialect == "krc4"):
                    raise PanelError(f"the check of an external axis shows {text!r}")
                if text and not self.prepared:
                    raise PanelError("tm_opt is not set before this message")
        return None

    def _require_main(self, depth: int, statement_name: str) -> None:
        if depth:
            raise PanelError(f"{statement_name} is allowed only in the main program")

    def _require_krc4(self, statement_name: str) -> None:
        if self.dialect != "krc4":
            raise PanelError(
                f"{statement_name} are not part of {self.dialect}, the dialect of the cell's controller"
            )

    def _require_options(self, depth: int, statement_name: str) -> None:
        self._require_krc4("messages")
        self._require_main(depth, statement_name)
        if not self.prepared:
            raise PanelError(f"tm_opt is not set before {statement_name}")

    def _halt(self, depth: int) -> PanelMessage | None:
        """Process a HALT, and return the question that it asks, or None if it asks none.

        The meaning of HALT depends on the dialect:

        - krc2: HALT asks the question in the marked comments (;?) above it. The operator answers by pressing
          Start. In automatic external a PLC could press Start instead. The program must therefore refuse this
          mode before its first question (``_external``), and again directly after each HALT (``_open``).
        - krc4: Questions are dialogs, and HALT asks nothing. It is allowed only directly after the message
          that asks the operator to start the other arm's program.

        Args:
            depth: Number of nested subprogram calls. HALT is allowed only in the main program, at depth 0.

        Raises:
            PanelError: The HALT is not allowed here.
        """
        self._require_main(depth, "HALT")
        if self.dialect == "krc4":
            start_requests = (
                normalised_text(sentences.START_PARTNER.format(other=arm)) for arm in self.others
            )
            if self._shown_before in start_requests:
                return None
            raise PanelError(f"HALT is no question: {_EXTERNAL_REASON}; use a dialog")
        if not self._question:
            raise PanelError("HALT without a question (;?) above it")
        if not self._external:  # no earlier statement refuses automatic external
            raise PanelError("a question is asked before automatic external is refused")
        text, self._question, self._open = " ".join(self._question), [], True
        return PanelMessage("HALT", text, confirm=True)

    def _dialog(self, text: str, key: str) -> PanelMessage | None:
        """Process a dialog, and return the message or question that it shows; None for part of a question.

        The first key of the dialog tells what its text is. Next: a part of a question, whose next part
        follows. Read: a message before a question. Yes: the last part of a question, which is asked now.
        """
        if key == "next":
            self._question.append(text)
            return None
        if key == "read":
            if self._question:
                raise PanelError("a text with the key Read is inside a question")
            self._reading = True
            return PanelMessage("Set_KrlDlg", text, panel="line")
        question, self._question, self._reading = " ".join([*self._question, text]), [], False
        return PanelMessage("Set_KrlDlg", question, confirm=True)

    def _state(self, text: str) -> PanelMessage:
        """Process the message of a state, which the panel shows until the program clears it.

        The text must say that the program waits for another arm, or that it moves with another arm.
        """
        forms = (krl_sentences.WAITING_FOR_PARTNER, krl_sentences.MOVING_WITH_PARTNER)
        allowed_texts = [form.format(arm=arm) for arm in self.others for form in forms]
        if text not in allowed_texts:
            expected = " or ".join(map(repr, allowed_texts)) or "nothing"
            raise PanelError(f"the panel shows {text!r} during a wait; expected {expected}")
        self._shown, self._waited = text, False
        return PanelMessage("#STATE", text)

    def _poll(self, depth: int) -> None:
        """Check that the panel shows why the program waits, and record that it has waited.

        In the main program the panel must say that the program waits for another arm. In a subprogram
        (``depth`` above 0) the program waits between moves, and the panel must say that both arms move.
        """
        forms = (krl_sentences.MOVING_WITH_PARTNER,) if depth else (krl_sentences.WAITING_FOR_PARTNER,)
        if self._shown not in [form.format(arm=arm) for arm in self.others for form in forms]:
            raise PanelError("the program waits for the other arm, but the panel does not show it")
        self._waited = True

    def _robroot(self, check: syntax_tree.RobrootCheck) -> None:
        """Verify a check of the robot's foot, and record that the foot was checked.

        Its external axes and its text must be the expected ones, and its tolerances must not be too large.
        """
        shift, angle, text = check.shift, check.turn, check.text
        self._require_axes(check.axis_directions)
        sentence = (
            krl_sentences.ROBROOT_TRACK_DEVIATION if self.axis_directions else krl_sentences.ROBROOT_DEVIATION
        )
        expected = sentence.format(arm=self.arm) if self.dialect == "krc4" else ""
        if text != expected:
            raise PanelError(f"the check of $ROBROOT shows {text!r}; expected {expected!r}")
        if text and not self.prepared:
            raise PanelError("tm_opt is not set before this message")
        if (
            shift > syntax_tree.ROBROOT_POSITION_TOLERANCE_MM
            or angle > syntax_tree.ROBROOT_ROTATION_TOLERANCE_DEG
        ):
            allowed = (
                f"{syntax_tree.ROBROOT_POSITION_TOLERANCE_MM:g} mm and "
                f"{syntax_tree.ROBROOT_ROTATION_TOLERANCE_DEG:g} deg"
            )
            raise PanelError(f"$ROBROOT may deviate by {shift:g} mm and {angle:g} deg; allowed: {allowed}")
        self.robroot_checked = True

    def _require_axes(self, checked_directions: Sequence[tuple[int, tuple[float, float, float]]]) -> None:
        """Raise `PanelError` unless a check of the foot uses exactly the external axes that move the foot.

        Args:
            checked_directions: Column and direction of each external axis in the check.
        """
        if not self.axis_directions:
            if checked_directions:
                raise PanelError("$ROBROOT_C is checked, but the arm is on no track; expected $ROBROOT")
            return
        if not checked_directions:
            expected_directions = _directions(self.axis_directions.items())
            raise PanelError(f"$ROBROOT is checked, but axes move the arm along {expected_directions}")
        columns = [column for column, _ in checked_directions]
        same = sorted(columns) == sorted(self.axis_directions) and all(
            max(abs(a - b) for a, b in zip(direction, self.axis_directions[column], strict=True))
            <= syntax_tree.DIRECTION_TOLERANCE
            for column, direction in checked_directions
        )
        if not same:
            actual, expected = _directions(checked_directions), _directions(self.axis_directions.items())
            raise PanelError(f"$ROBROOT_C is checked along {actual}; axes move the arm along {expected}")


def _directions(axis_directions: Iterable[tuple[int, tuple[float, float, float]]]) -> str:
    """Return directions of external axes as text for messages, such as ``(1, 0, 0) by E1``."""
    parts = (
        f"({', '.join(f'{v:g}' for v in direction)}) by E{column + 1}"
        for column, direction in axis_directions
    )
    return " and ".join(parts)


RowMatches = Sequence[re.Match[str]]
MAX_TEXT_LENGTH = 80
"""Maximum length of a message's text [characters]."""
_PARAMETER = re.compile(r"%\d")
"""A parameter in a message's text."""
_PLACEHOLDERS = {"<text>": r'"([^"]*)"', "<number>": r"(\d+(?:\.\d+)?)", "<whole>": r"\d+"}
"""Patterns for the placeholders in the forms below."""

VARIABLES = {
    "krc4": {
        "tm_msg": "krlmsg_t",
        "tm_par[3]": "krlmsgpar_t",
        "tm_opt": "krlmsgopt_t",
        "tm_key[7]": "krlmsgdlgsk_t",
        "tm_ticket": "int",
        "tm_state": "int",
        "tm_answer": "int",
        "tm_gone": "bool",
        "tm_shift": "real",
        "tm_turn": "real",
    },
    "krc2": {"tm_shift": "real", "tm_turn": "real"},
}
"""Variables of a main program by dialect: {name with its size: type}."""


@dataclass(frozen=True)
class StatementForm:
    """Fixed sequence of rows that makes one statement; comments between them are ignored.

    Attributes:
        what: Name of the statement for messages.
        rows: Patterns of the rows, one for each.
        build: Builds the statement from the line of its first row and the matches of all rows.
    """

    what: str
    rows: tuple[re.Pattern[str], ...]
    build: Callable[[int, RowMatches], syntax_tree.KrlStatement]


def _row_pattern(code: str) -> re.Pattern[str]:
    """Return the pattern that matches a row of code, whatever blanks and case it has.

    In ``code``, <text> stands for a string, <number> for a number and <whole> for an integer. Two words must
    be separated by a blank in the row. Next to any other character blanks are optional, except at a dot.
    """
    words = re.findall(r'<[\w|]+>|"[^"]*"|==|<>|\d+\.\d+|[$#]?\w+|[^\w\s]', code)
    pattern = ""
    for previous, word in zip(["", *words], words, strict=False):
        if previous and "." not in (previous, word):
            pattern += r"\s+" if re.match(r"[\w$#]", word) and re.search(r"\w$", previous) else r"\s*"
        pattern += _PLACEHOLDERS.get(word, re.escape(word))
    return re.compile(pattern, re.IGNORECASE | re.ASCII)


def _row_patterns(*code: str) -> tuple[re.Pattern[str], ...]:
    return tuple(map(_row_pattern, code))


def _panel_text(text: str) -> str:
    """Return the text of a message unchanged.

    Raises `KrlValueError` for a text that the panel would cut or in which it would insert parameters.
    """
    if len(text) > MAX_TEXT_LENGTH:
        message = f"a text of {len(text)} characters; allowed: {MAX_TEXT_LENGTH}"
        raise KrlValueError("string_length", message)
    if _PARAMETER.search(text):
        raise KrlValueError(
            "syntax", f"{text!r:.40} contains a parameter mark, but the message has no parameters"
        )
    return text


_ROBROOT_VALUES = (
    "tm_shift=SQRT($ROBROOT.X*$ROBROOT.X+$ROBROOT.Y*$ROBROOT.Y+$ROBROOT.Z*$ROBROOT.Z)",
    "tm_turn=ABS($ROBROOT.A)+ABS($ROBROOT.B)+ABS($ROBROOT.C)",
)
"""Statements that compute the deviation of $ROBROOT from zero."""
_AXIS_TERM = r"[+-]\s*\d(?:\.\d+)?\s*\*\s*\$AXIS_ACT\.E[1-6]"
_TRACK_DEVIATION = rf"ABS\s*\(\s*\$ROBROOT_C\.%s\s*((?:{_AXIS_TERM}\s*)+)\)"
_AXIS_TERMS = re.compile(r"([+-])\s*(\d(?:\.\d+)?)\s*\*\s*\$AXIS_ACT\.E([1-6])", re.IGNORECASE | re.ASCII)
_TRACK_VALUES = (
    *(
        re.compile(rf"tm_shift\s*=\s*{before}{_TRACK_DEVIATION % axis}", re.IGNORECASE | re.ASCII)
        for before, axis in (("", "X"), (r"tm_shift\s*\+\s*", "Y"), (r"tm_shift\s*\+\s*", "Z"))
    ),
    _row_pattern("tm_turn=ABS($ROBROOT_C.A)+ABS($ROBROOT_C.B)+ABS($ROBROOT_C.C)"),
)
"""Statements that compute the deviation of $ROBROOT_C for an arm on external axes.

They subtract the motion of these axes from X, Y and Z, so that the deviation does not depend on it.
"""
_ROBROOT_LOOP = "WHILE (tm_shift><number>) OR (tm_turn><number>)"
"""The loop that repeats while the deviation is too large."""
_MESSAGE = 'tm_msg={Modul[] "Tandem",Nr <whole>,Msg_txt[] <text>}'
"""The statement that sets a message."""
_ROBROOT_MESSAGE = (
    "tm_par[1].Par_Type=#VALUE",
    "tm_par[1].Par_Real=tm_shift",
    "tm_par[2].Par_Type=#VALUE",
    "tm_par[2].Par_Real=tm_turn",
    _MESSAGE,
    "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)",
)
"""Statements that show the deviation."""
_PARAMETER_RESET = ("tm_par[1].Par_Type=#EMPTY", "tm_par[2].Par_Type=#EMPTY")


def _dialog(line: int, matches: RowMatches) -> syntax_tree.KrlStatement:
    """Build a dialog from the rows of its form: its text is in row 2, its soft keys are in rows 3 and 4.

    The second key is No if the first one is Yes, and empty if the first one is Next or Read.
    """
    first_key, second_key = matches[3][1].lower(), matches[4][1]
    if (first_key == "yes") != (second_key is not None):
        message = (
            f"a dialog has the keys Yes and No, or only Next or Read; got {matches[3][1]} and {second_key}"
        )
        raise KrlValueError("syntax", message)
    return syntax_tree.DialogStatement(line, _panel_text(matches[2][1]), first_key)


_QUESTION = _row_patterns(
    "tm_answer=0",
    "WHILE tm_answer<>1",
    _MESSAGE,
    "tm_key[1]={SK_type #VALUE,SK_txt[] <text>}",
    "tm_key[2]=",
    "tm_ticket=Set_KrlDlg(tm_msg,tm_par[],tm_key[],tm_opt)",
    "WHILE Exists_KrlDlg(tm_ticket,tm_answer)",
    "WAIT SEC 0.1",
    "ENDWHILE",
    "WAIT SEC 0.1",
    "ENDWHILE",
)
"""Statements that ask a question until it is answered."""
_FIRST_KEY = re.compile(
    r'tm_key\s*\[\s*1\s*\]\s*=\s*\{\s*SK_type\s+#VALUE\s*,\s*SK_txt\s*\[\s*\]\s*"(Yes|Next|Read)"\s*\}',
    re.IGNORECASE | re.ASCII,
)
"""The soft key that answers."""
_SECOND_KEY = re.compile(
    r"tm_key\s*\[\s*2\s*\]\s*=\s*"
    r'\{\s*SK_type\s+(?:#EMPTY|#VALUE\s*,\s*SK_txt\s*\[\s*\]\s*"(No)")\s*\}',
    re.IGNORECASE | re.ASCII,
)
"""The other soft key: a second answer, or empty."""


def _robroot_check(line: int, matches: RowMatches, text: str, on_axes: bool) -> syntax_tree.KrlStatement:
    """Build the check of the robot's foot from the rows of its form.

    The rows that compute the deviation occur twice, before the loop and at its end. Raises `KrlValueError` if
    they differ in the directions of external axes.

    Args:
        line: Line of the first row, from 1.
        matches: Matches of the rows.
        text: Message that the check shows, "" for none.
        on_axes: Whether external axes move the foot.
    """
    value_rows = len(_TRACK_VALUES) if on_axes else len(_ROBROOT_VALUES)
    along: tuple[tuple[int, tuple[float, float, float]], ...] = ()
    if on_axes:
        # the WHILE and the HALT are between them, and the statements of the message if there is a text
        second_start = value_rows + (2 + len(_ROBROOT_MESSAGE) if text else 2)
        first, again = (_axis_directions(matches[k : k + 3]) for k in (0, second_start))
        if first != again:
            message = f"$ROBROOT_C is checked along {first} first, and then along {again}"
            raise KrlValueError("type", message)
        along = first
    return syntax_tree.RobrootCheck(
        line, float(matches[value_rows][1]), float(matches[value_rows][2]), text, along
    )


def _axis_directions(rows: RowMatches) -> tuple[tuple[int, tuple[float, float, float]], ...]:
    """Return column and direction of each external axis whose motion three rows, for X, Y and Z, subtract.

    A row subtracts the motion, so a term with "-" has a positive part of the direction. Raises
    `KrlValueError` unless the three rows use the same axes, each once.
    """
    # + 0.0 turns -0.0 into 0.0
    parts = [
        [(int(axis) - 1, (1.0 if sign == "-" else -1.0) * float(size) + 0.0) for sign, size, axis in terms]
        for terms in (_AXIS_TERMS.findall(row[1]) for row in rows)
    ]
    columns = [[column for column, _ in row_terms] for row_terms in parts]
    # each axis once in the first row, and the same axes in the other two rows
    if len(set(columns[0])) < len(columns[0]) or columns[1:] != columns[:1] * 2:
        shown = "; ".join(", ".join(f"E{column + 1}" for column in row_terms) for row_terms in columns)
        raise KrlValueError(
            "type", f"$ROBROOT_C is checked by {shown}; expected each axis once, in X, Y and Z"
        )
    directions = zip(*([size for _, size in row_terms] for row_terms in parts), strict=True)
    return tuple(zip(columns[0], ((x, y, z) for x, y, z in directions), strict=True))


def _robroot_forms(
    what: str, values: tuple[re.Pattern[str], ...], on_axes: bool = False
) -> tuple[StatementForm, StatementForm]:
    """Return two forms of the check of the robot's foot: one shows nothing, one shows the deviation.

    ``values`` are the patterns of the rows that compute the deviation; ``on_axes``: external axes move the
    foot.
    """
    head = _row_patterns(_ROBROOT_LOOP)
    silent = _row_patterns("HALT")
    shown = _row_patterns(*_ROBROOT_MESSAGE, "HALT")
    text_index = len(values) + len(head) + _ROBROOT_MESSAGE.index(_MESSAGE)
    return (
        StatementForm(
            what,
            (*values, *head, *silent, *values, *_row_patterns("ENDWHILE")),
            lambda line, matches: _robroot_check(line, matches, "", on_axes),
        ),
        StatementForm(
            what,
            (*values, *head, *shown, *values, *_row_patterns("ENDWHILE", *_PARAMETER_RESET)),
            lambda line, matches: _robroot_check(line, matches, matches[text_index][1], on_axes),
        ),
    )


_AXIS_DEVIATION = (
    re.compile(
        r"tm_shift\s*=\s*ABS\s*\(\s*\$AXIS_ACT\.E([1-6])\s*([+-])\s*(\d+(?:\.\d+)?)\s*\)",
        re.IGNORECASE | re.ASCII,
    ),
    re.compile(r"IF\s+tm_shift\s*>\s*(\d+(?:\.\d+)?)\s+THEN", re.IGNORECASE | re.ASCII),
)
"""Statements that compute the deviation of an external axis from home, and start the reaction to it."""
_AXIS_MESSAGE = _row_patterns(*_ROBROOT_MESSAGE[:2], *_ROBROOT_MESSAGE[4:])
_STOP_FOR_GOOD = _row_patterns("LOOP", "HALT", "ENDLOOP", "ENDIF")


def _axis_check(line: int, matches: RowMatches, text: str) -> syntax_tree.KrlStatement:
    """Build the check that an external axis is at home before the program moves the arm.

    The row subtracts the home value, so "-" before the number means a positive home value.
    """
    home = float(matches[0][3]) * (1.0 if matches[0][2] == "-" else -1.0)
    return syntax_tree.ExternalAxisCheck(line, int(matches[0][1]) - 1, home + 0.0, float(matches[1][1]), text)


PANEL_FORMS: tuple[StatementForm, ...] = (
    StatementForm(
        "the interrupt of stop messages",
        _row_patterns("GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM()"),
        lambda line, _: syntax_tree.StopInterrupt(line, False),
    ),
    StatementForm(
        "the interrupt of stop messages",
        _row_patterns("INTERRUPT ON 3"),
        lambda line, _: syntax_tree.StopInterrupt(line, True),
    ),
    StatementForm(
        "the refusal of automatic external",
        _row_patterns("WHILE $MODE_OP==#EX", "HALT", "ENDWHILE"),
        lambda line, _: syntax_tree.ExternalModeRefusal(line),
    ),
    StatementForm("a dialog", (*_QUESTION[:3], _FIRST_KEY, _SECOND_KEY, *_QUESTION[5:]), _dialog),
    StatementForm(
        "the options of messages",
        _row_patterns(
            "tm_opt={VL_Stop TRUE,Clear_P_Reset TRUE,Clear_P_SAW TRUE,Log_To_DB FALSE}",
            *(f"tm_par[{i}]={{Par_Type #EMPTY}}" for i in range(1, 4)),
            *(f"tm_key[{i}]={{SK_type #EMPTY}}" for i in range(3, 8)),
        ),
        lambda line, _: syntax_tree.MessageOptions(line),
    ),
    StatementForm(
        "a message",
        (
            _row_pattern(_MESSAGE),
            re.compile(
                _row_pattern("tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)").pattern
                + "|("
                + _row_pattern("tm_state=Set_KrlMsg(#STATE,tm_msg,tm_par[],tm_opt)").pattern
                + ")",
                re.IGNORECASE | re.ASCII,
            ),
        ),
        lambda line, matches: syntax_tree.MessageStatement(
            line, _panel_text(matches[0][1]), matches[1][1] is not None
        ),
    ),
    StatementForm(
        "the check of an external axis",
        (*_AXIS_DEVIATION, *_STOP_FOR_GOOD),
        lambda line, matches: _axis_check(line, matches, ""),
    ),
    StatementForm(
        "the check of an external axis",
        (*_AXIS_DEVIATION, *_AXIS_MESSAGE, *_STOP_FOR_GOOD),
        lambda line, matches: _axis_check(line, matches, matches[4][1]),
    ),
    StatementForm(
        "the end of a state",
        _row_patterns("tm_gone=Clear_KrlMsg(tm_state)"),
        lambda line, _: syntax_tree.ClearState(line),
    ),
    *_robroot_forms("the check of $ROBROOT", _row_patterns(*_ROBROOT_VALUES)),
    *_robroot_forms("the check of $ROBROOT_C", _TRACK_VALUES, on_axes=True),
)
"""All forms. If several have equal first rows, the one that matches the most rows of the text applies."""


def parse_variables(code: str) -> tuple[tuple[str, str], ...] | None:
    """Return the lower-case (type, name) pairs of a DECL in a program; None for any other row."""
    match = re.fullmatch(
        r"DECL\s+(\w+)\s+(\w+(?:\[\d+\])?(?:\s*,\s*\w+(?:\[\d+\])?)*)", code, re.IGNORECASE | re.ASCII
    )
    if match is None:
        return None
    kind = match[1].lower()
    return tuple((kind, name.strip().lower()) for name in match[2].split(","))
