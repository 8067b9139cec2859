"""What one KRL program asks and says on its panel, and what it has to look at before it moves: the order of
these statements, whatever stands between them.

A question is certain where nothing but the operator answers it: a dialog (krc4), or HALT in a mode of
operation in which no PLC starts programs (krc2), which the statement behind it sees to.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

from planner import dialogue
from planner.verify import krl_words
from planner.verify.krl_ast import (
    Call,
    Cleared,
    Dialog,
    Foot,
    Halt,
    Listen,
    NotExternal,
    Notice,
    Prepared,
    Said,
    Statement,
)
from planner.verify.words import letters

_PLC = "in automatic external a PLC that starts the program again answers it"


class PanelError(Exception):
    """A statement stands where it may not."""


class Message(NamedTuple):
    """What is shown: the statement's own word, the text, whether it is a question, and whether it stays on
    the panel as a line."""

    kind: str
    text: str
    confirm: bool = False
    panel: Literal["line", "clear", ""] = ""


class Panel:
    """Follows the statements of a program. ``arm``, ``others``: the names of its arm and of those that it may
    wait for. `looked`: at the robot's foot."""

    def __init__(self, dialect: str, arm: str, others: Sequence[str]) -> None:
        self.dialect, self.arm, self.others = dialect, arm, others
        self.looked = False
        self._question: list[str] = []
        self._reading = False
        self._open = False
        """Whether a HALT has asked, and the mode of operation is not looked at yet."""
        self._external = False
        self._prepared = False
        self._shown = ""
        self._waited = False
        self._told = ""
        """What was shown right before, in letters."""

    def check(self, statement: Statement | None, depth: int) -> None:
        """Raises `PanelError` where the statement, or the program's end, may not come next."""
        if isinstance(statement, Said):
            return
        answer: type[Statement] = Dialog if self.dialect == "krc4" else Halt
        if self._question and not isinstance(statement, answer):
            behind = "dialog with the key Yes" if answer is Dialog else "HALT"
            raise PanelError(f"a question that no {behind} follows")
        if self._reading and not isinstance(statement, Dialog):
            raise PanelError("a text that is to be read before a question, and no question follows")
        if self._open and not isinstance(statement, NotExternal):
            raise PanelError(f"HALT is no question by itself: {_PLC}; refuse that mode right behind it")
        if self._shown and depth == 0 and not isinstance(statement, Listen | Call | Cleared):
            raise PanelError(f"the panel says {self._shown!r} here, which is not so")

    def halts(self, statement: Statement) -> bool:
        """Whether the program may halt at the statement without having asked anything."""
        alone = isinstance(statement, Halt) and self.dialect == "krc4"
        return alone or isinstance(statement, Foot) or (isinstance(statement, NotExternal) and not self._open)

    def take(self, statement: Statement, depth: int) -> Message | None:
        """What a statement shows. Raises `PanelError`."""
        said = self._take(statement, depth)
        if not isinstance(statement, Said):
            self._told += letters(said.text) if said is not None and said.kind == "#NOTIFY" else ""
            self._told = self._told if isinstance(statement, Notice) else ""
        return said

    def _take(self, statement: Statement, depth: int) -> Message | None:
        match statement:
            case Said(kind="question", text=text) if self.dialect == "krc2":
                self._main(depth, "a question (;?)")
                self._question.append(text)
            case Said(kind="told", text=text) if self.dialect == "krc2":
                return Message(";*", text, panel="line")
            case Halt():
                return self._halt(depth)
            case NotExternal():
                self._main(depth, "the refusal of automatic external")
                if self.dialect == "krc4" or (self._external and not self._open):
                    raise PanelError("automatic external is refused where nothing is asked; HALT stops there")
                self._external, self._open = True, False
            case Prepared():
                self._new("messages")
                self._prepared = True
            case Dialog(text=text, key=key):
                self._ready(depth, "a dialog")
                return self._dialog(text, key)
            case Notice(text=text, state=False):
                self._ready(depth, "a message")
                return Message("#NOTIFY", text, panel="line")
            case Notice(text=text):
                self._ready(depth, "a message")
                return self._state(text)
            case Cleared():
                if not self._shown or not self._waited:
                    raise PanelError("a state is taken back that is not shown, or was none of waiting")
                self._shown = ""
            case Listen() if self.dialect == "krc4":
                self._listens(depth)
            case Foot(shift=shift, turn=turn, text=text):
                self._main(depth, "the look at $ROBROOT")
                self._foot(shift, turn, text)
        return None

    def _main(self, depth: int, what: str) -> None:
        if depth:
            raise PanelError(f"{what} stands elsewhere than in the main program")

    def _new(self, what: str) -> None:
        if self.dialect != "krc4":
            raise PanelError(f"{what} are not of the dialect {self.dialect}, which the cell's controller has")

    def _ready(self, depth: int, what: str) -> None:
        self._new("messages")
        self._main(depth, what)
        if not self._prepared:
            raise PanelError(f"{what}, and tm_opt is not set before")

    def _halt(self, depth: int) -> Message | None:
        """A question of krc2; in krc4 the stop in which the program of another arm is started."""
        self._main(depth, "HALT")
        if self.dialect == "krc4":
            calls = (letters(dialogue.START_PARTNER.say(other=arm)) for arm in self.others)
            if self._told in calls:
                return None
            raise PanelError(f"HALT is no question: {_PLC}; ask by a dialog")
        if not self._question:
            raise PanelError("HALT without a question (;?) above it")
        if not self._external:
            raise PanelError("a question before automatic external is refused")
        text, self._question, self._open = " ".join(self._question), [], True
        return Message("HALT", text, True)

    def _dialog(self, text: str, key: str) -> Message | None:
        if key == "next":
            self._question.append(text)
            return None
        if key == "read":
            if self._question:
                raise PanelError("a text that is to be read stands within a question")
            self._reading = True
            return Message("Set_KrlDlg", text, panel="line")
        whole, self._question, self._reading = " ".join([*self._question, text]), [], False
        return Message("Set_KrlDlg", whole, True)

    def _state(self, text: str) -> Message:
        forms = (dialogue.WAITING, dialogue.TOGETHER)
        known = [form.say(arm=arm) for arm in self.others for form in forms]
        if text not in known:
            wanted = " or ".join(map(repr, known)) or "nothing"
            raise PanelError(f"the panel says {text!r} while it waits; wanted: {wanted}")
        self._shown, self._waited = text, False
        return Message("#STATE", text)

    def _listens(self, depth: int) -> None:
        forms = (dialogue.TOGETHER,) if depth else (dialogue.WAITING,)
        if self._shown not in [form.say(arm=arm) for arm in self.others for form in forms]:
            raise PanelError("the program waits for the other arm, and the panel does not say so")
        self._waited = True

    def _foot(self, shift: float, turn: float, text: str) -> None:
        wanted = dialogue.FOOT.say(arm=self.arm) if self.dialect == "krc4" else ""
        if text != wanted:
            raise PanelError(f"$ROBROOT is looked at with the text {text!r}; wanted: {wanted!r}")
        if text and not self._prepared:
            raise PanelError("a message, and tm_opt is not set before")
        if shift > krl_words.FOOT_SHIFT or turn > krl_words.FOOT_TURN:
            allowed = f"{krl_words.FOOT_SHIFT:g} mm and {krl_words.FOOT_TURN:g} deg"
            raise PanelError(f"$ROBROOT may be off by {shift:g} mm and {turn:g} deg; allowed: {allowed}")
        self.looked = True
