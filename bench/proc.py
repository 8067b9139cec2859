"""Processes below one, as Linux tells of them (proc(5)): which there are, and what they have used."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path


def below(pid: int) -> Iterator[int]:
    """All that a process has started and what these have, parents first; none of what has ended."""
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = [int(child) for child in path.read_text().split()]
        except OSError:
            continue
        for child in children:
            yield child
            yield from below(child)


def processor_time(pid: int) -> float:
    """User and system time [s] of a process so far (stat, fields 14 and 15); raises ``OSError`` for one that
    has ended."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
