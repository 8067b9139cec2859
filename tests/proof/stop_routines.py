"""Interpreters of stop routines in controller files: ABB event routines, lines of a KUKA submit interpreter.

They have their own readers, which use neither the planner's nor the proof's expected texts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

Ask = tuple[str, str, tuple[str, ...]]
"""A question, its text and its answers; or a stop, or a wait, without both."""


class Routines:
    """The procedures of a system module; ``signals`` and ``flags`` are what they read and set."""

    def __init__(self, text: str, signals: dict[str, int]) -> None:
        lines = [line.partition("!")[0].strip() for line in text.replace("\r\n", "\n").split("\n")]
        joined = re.sub(r"\s+", " ", " ".join(lines))
        self.signals = signals
        self.flags = dict.fromkeys(re.findall(r"PERS bool (\w+):=FALSE;", joined), False)
        self.bodies = {
            name: re.findall(r"\s*((?:IF|ELSEIF|WHILE) .*?(?:THEN|DO)(?=\s)|ELSE\b|END\w+|[^;]+;)", body)
            for name, body in re.findall(r"PROC (\w+)\(\) (.*?) ?ENDPROC", joined)
        }

    def holds(self, condition: str, answer: int) -> bool:
        """Return whether a condition is true now."""
        text = re.sub(r"DOutput\((\w+)\)=(\d)", lambda m: str(self.signals[m[1]] == int(m[2])), condition)
        text = re.sub(r"answer=(\d)", lambda m: str(answer == int(m[1])), text)
        text = re.sub(r"tandem_\w+", lambda m: str(self.flags[m[0]]), text)
        words = {"AND": "and", "OR": "or", "NOT": "not", "TRUE": "True", "FALSE": "False"}
        return bool(eval(re.sub(r"[A-Z]+", lambda m: words.get(m[0], m[0]), text)))

    def run(self, name: str) -> Iterator[Ask]:
        """Runs a procedure; what is yielded waits: an answer is sent back, from 1 on."""
        body, answer, at, loops = [s.strip() for s in self.bodies[name]], 0, 0, list[int]()
        while at < len(body):
            one = body[at]
            if found := re.match(r"(WHILE|IF) (.*) (?:DO|THEN)$", one):
                if self.holds(found[2], answer):
                    loops += [at] if found[1] == "WHILE" else []
                else:
                    at = self._skip_branch(body, at, found[1], answer)
                    continue
            elif re.match(r"ELSE", one):
                at = self._end(body, at)  # the branch before it was run
                continue
            elif one == "ENDWHILE":
                at = loops.pop()
                continue
            elif found := re.match(r"SetDO (\w+),(\d);", one):
                self.signals[found[1]] = int(found[2])
            elif found := re.match(r"(tandem_\w+):=(\w+);", one):
                self.flags[found[1]] = found[2] == "TRUE"
            elif found := re.match(r"answer:=.*MsgArray:=\[(.*)\]\s*\\BtnArray:=\[(.*)\]", one):
                texts = [re.findall(r'"([^"]*)"', part) for part in found.groups()]
                answer = yield ("ask", " ".join(texts[0]), tuple(texts[1]))
            elif one.startswith("Stop"):
                yield ("stop", "", ())
            elif found := re.match(r"WaitUntil (.*);", one):
                while not self.holds(found[1], answer):
                    yield ("wait", "", ())
            elif found := re.match(r"(tandem_\w+);", one):
                yield from self.run(found[1])
            else:
                assert re.match(r"TPWrite|VAR num|ENDIF", one), one
            at += 1

    def _end(self, body: list[str], at: int) -> int:
        """Return the end of the IF that encloses a row."""
        depth = 0
        for k in range(at, len(body)):
            depth += body[k].startswith("IF ")
            if body[k] == "ENDIF":
                if depth == 0:
                    return k
                depth -= 1
        raise AssertionError("IF without ENDIF")

    def _skip_branch(self, body: list[str], at: int, word: str, answer: int) -> int:
        """Return the row to continue at if the condition of a row is false."""
        depth = 0
        for k in range(at + 1, len(body)):
            opens = body[k].startswith(f"{word} ")
            if not opens and depth == 0 and word == "IF" and body[k].startswith("ELSE"):
                found = re.match(r"ELSEIF (.*) THEN$", body[k])
                if found is None or self.holds(found[1], answer):
                    return k + 1
            if body[k] == f"END{word}":
                if depth == 0:
                    return k + 1
                depth -= 1
            depth += opens
        raise AssertionError(f"{word} without its end")


class Submit:
    """Lines of a submit interpreter and of IR_STOPM over outputs ``out`` and variables ``values``."""

    def __init__(self, submit: str, stopped: str, out: dict[int, bool]) -> None:
        self.submit, self.stopped = (
            [line.partition(";")[0].strip() for line in text.replace("\r\n", "\n").split("\n")]
            for text in (submit, stopped)
        )
        self.out = out
        self.values: dict[str, object] = {"TANDEM_CUT": False, "TANDEM_LIT": False, "$OV_PRO": 100}

    def value(self, text: str) -> object:
        """Evaluate an expression in the current state."""
        text = re.sub(r"\$OUT\[(\d+)\]", lambda m: str(self.out[int(m[1])]), text)
        text = re.sub(r"\$PRO_STATE1==(#\w+)", lambda m: str(self.values["$PRO_STATE1"] == m[1]), text)
        text = re.sub(r"\$?[A-Z]\w*_\w+", lambda m: str(self.values[m[0]]), text)
        words = {"AND": "and", "NOT": "not", "OR": "or", "TRUE": "True", "FALSE": "False"}
        return eval(re.sub(r"[A-Z]+", lambda m: words.get(m[0], m[0]), text))

    def run(self, lines: list[str]) -> None:
        """Runs lines once."""
        open_ = [True]
        for line in filter(None, lines):
            if found := re.match(r"IF (.*) THEN$", line):
                open_.append(open_[-1] and bool(self.value(found[1])))
            elif line == "ENDIF":
                open_.pop()
            elif open_[-1]:
                name, _, text = line.partition("=")
                if found := re.match(r"\$OUT\[(\d+)\]$", name):
                    self.out[int(found[1])] = bool(self.value(text))
                else:
                    self.values[name] = self.value(text)
