"""Where a job's result goes: planned in a hidden folder beside it, renamed when it is whole."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from planner.batch.job import Done
from planner.files import RESULT, is_file, staging, unhurried, write_whole
from planner.issues import Issue, TandemError


@dataclasses.dataclass(frozen=True)
class Record:
    """What a batch remembers of a job, as JSON in the file ``path``: its :class:`Done`, and ``more``."""

    path: Path
    more: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def write(self, done: Done) -> None:
        """Write it, whole or not at all; raises ``OSError``."""
        write_whole(self.path, json.dumps({**self.more, **done.to_dict()}, indent=1, allow_nan=False))

    @staticmethod
    def read(path: Path) -> tuple[Done, dict[str, Any]] | None:
        """The record in a file and all that it says; None where there is none, or it is no record."""
        try:
            data = json.loads(path.read_text("utf-8"))
            return Done.from_dict(data), data
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None


class Place:
    """The result folder of one job and, while it is planned, the hidden folder that it is planned in."""

    def __init__(self, folder: Path, record: Record | None) -> None:
        self.folder, self.record = folder, record
        self._open = contextlib.ExitStack()
        self._hidden: Path | None = None

    @staticmethod
    def claim(folder: Path, record: Record | None) -> Place:
        """The place, if ``folder`` can be one: missing, or a result. Raises ``TandemError``
        (``output.folder``)."""
        if os.path.lexists(folder):
            foreign = (
                sorted(p.name for p in folder.iterdir() if p.name not in RESULT) if folder.is_dir() else []
            )
            if foreign or folder.is_symlink() or not folder.is_dir():
                got = f"holds {', '.join(foreign[:3])}" if foreign else "is no folder"
                what = f"output folder {folder}: it {got}, and a result would replace it; choose another"
                raise TandemError(Issue("output.folder", what, file=str(folder)))
        return Place(folder, record)

    def prepare(self, files: Mapping[str, bytes]) -> tuple[Path, Path]:
        """Write the job's files; where they lie, and where its result is to be written. Raises
        ``TandemError`` (``output.folder``)."""
        try:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            self._hidden = self._open.enter_context(staging(self.folder.parent)).resolve()
            source = self._hidden / "problem"
            for name, content in files.items():
                path = source / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
        except OSError as error:
            self.leave()
            raise TandemError(self._refusal(error)) from error
        return source, self._hidden / "result"

    def publish(self, done: Done) -> Done:
        """Let the result appear under its name, with its record; a job that wrote none gets the report alone.

        What is given back has ``output.folder`` as one more issue where the disk refuses.
        """
        try:
            hidden = self._hidden or self.prepare({})[1].parent
            result = hidden / "result"
            if not is_file(result / "report.html"):
                from planner.batch.solve import write_failure

                write_failure(result, done.issues)
            with unhurried():
                if os.path.lexists(self.folder):
                    self.folder.rename(hidden / "old")
                if self.record is not None:
                    self.record.write(done)
                result.rename(self.folder)
        except OSError as error:
            done = _also(done, (self._refusal(error),))
        except TandemError as error:
            done = _also(done, error.issues)
        finally:
            self.leave()
        return done

    def _refusal(self, error: OSError) -> Issue:
        what = f"output folder {self.folder}: cannot be written ({error.strerror or error})"
        return Issue(
            "output.folder",
            what,
            file=str(self.folder),
            hint="see to the disk, or choose another folder, and run again",
        )

    def leave(self) -> None:
        """Remove the hidden folder; the place can be prepared anew."""
        self._open.close()
        self._hidden = None


def _also(done: Done, issues: tuple[Issue, ...]) -> Done:
    """An end whose result could not be written."""
    return dataclasses.replace(done, state="crashed", issues=(*done.issues, *issues))
