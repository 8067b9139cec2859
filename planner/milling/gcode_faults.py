"""What is wrong with a G-code file, collected line by line: repeats are counted, first lines kept."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Final

from planner.issues import Issue, Severity, has_errors

SHOWN: Final = 3
MOST: Final = 50
"""Different faults of one file that are told; a file that is no G-code at all has one on each line."""


@dataclasses.dataclass
class _Fault:
    """One kind of fault: its first message, the first lines (from 1) that have it, and how many do."""

    message: str
    severity: Severity
    lines: list[int]
    count: int


class Faults:
    """Collects faults in bounded memory, whatever the length of the file."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.left_out = 0
        self._found: dict[tuple[str, str], _Fault] = {}

    def add(
        self,
        code: str,
        word: str,
        line: int,
        message: str,
        count: int = 1,
        severity: Severity = Severity.ERROR,
    ) -> None:
        """Note ``count`` lines, the first of which is ``line``; those of one code and word are one fault."""
        known = self._found.get((code, word))
        if known is not None:
            known.count += count
            if len(known.lines) < SHOWN:
                known.lines.append(line)
        elif len(self._found) < MOST:
            self._found[code, word] = _Fault(message, severity, [line], count)
        else:
            self.left_out += count

    @property
    def errors(self) -> bool:
        """Whether the file is refused."""
        return has_errors(self.issues())

    def issues(self) -> tuple[Issue, ...]:
        """All faults, in the order in which the file has them, each with its first line."""
        out = [self._issue(*key, fault) for key, fault in self._found.items()]
        if self.left_out:
            what = f"{self.left_out} more faults of other kinds; see to these first"
            out.append(Issue("gcode.syntax", what, file=str(self.file)))
        return tuple(out)

    def _issue(self, code: str, word: str, fault: _Fault) -> Issue:
        message = fault.message
        if fault.count > 1:
            more = fault.count - len(fault.lines)
            shown = ", ".join(str(line) for line in fault.lines)
            message += f" [lines {shown}{f' and {more} more' if more else ''}]"
        return Issue(
            code,
            message,
            fault.severity,
            file=str(self.file),
            line=fault.lines[0],
            field=word or None,
            count=fault.count,
        )
