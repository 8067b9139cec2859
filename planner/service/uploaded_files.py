"""The uploads of one problem: files found by the names it says, and what is known of it once read.

Files are found among the uploads, never on the disk; what is told calls them by the user's names.
Both the service and the processes that read uploads import this, so it stays light.
"""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from planner.issues import Issue
from planner.reading import strict_yaml
from planner.reading.strict_yaml import Document

NOWHERE: Final = "files/not-uploaded"
"""Stands for a file that was not uploaded; there is none of this name."""
_SUFFIX: Final = re.compile(r"\.[A-Za-z0-9]{1,8}")
"""An ending of a name that is kept."""


class Uploaded:
    """The uploads of one problem: ``uploads`` {name that the user gave: stored file}, laid into ``folder``
    under names of our own when the problem names them."""

    def __init__(self, folder: Path, uploads: Mapping[str, Path]) -> None:
        self._folder, self._uploads = folder, uploads
        self._names: dict[str, str] = {}
        self._cell: Document | None = None
        self._faults: list[Issue] = []
        (folder / "files").mkdir()

    def inside(self, document: Document) -> tuple[Document, list[Issue]]:
        """The document with every file name changed to one in the folder and a cell's file written out, and
        a fault for each name that is no upload's."""
        data = self._changed(document.data, document, ())
        if isinstance(data.get("cell"), str):
            path = self._laid(data["cell"], document, ("cell",))
            if path == NOWHERE:
                data["cell"] = NOWHERE
            else:
                self._cell = strict_yaml.read(self._folder / path)
                data["cell"] = self._changed(self._cell.data, self._cell, ("cell",))
        return document.with_data(data), self._faults

    def in_user_names(self, issues: Iterable[Issue]) -> tuple[Issue, ...]:
        """The issues without paths of this machine, those of a cell's file with its lines."""
        return tuple(self._in_user_names(issue) for issue in issues)

    def _in_user_names(self, issue: Issue) -> Issue:
        place = (issue.field or "").split(".")
        if self._cell is not None and place[0] == "cell" and len(place) > 1:
            steps = tuple(int(step) if step.isdigit() else step for step in place[1:])
            issue = dataclasses.replace(issue, file=str(self._cell.path), line=self._cell.line(steps))
        return dataclasses.replace(
            issue,
            message=self._plain(issue.message) or "",
            file=self._plain(issue.file),
            field=self._plain(issue.field),
            hint=self._plain(issue.hint),
        )

    def _plain(self, text: str | None) -> str | None:
        if text is None:
            return None
        for path, name in self._names.items():
            text = text.replace(path, name).replace(base_name(path), base_name(name))
        return text.replace(f"{self._folder}{os.sep}", "")

    def _changed(self, data: Any, document: Document, place: tuple[str | int, ...]) -> Any:
        if isinstance(data, dict):
            return {
                key: self._laid(value, document, (*place, key))
                if key == "file" and isinstance(value, str)
                else self._changed(value, document, (*place, key))
                for key, value in data.items()
            }
        if isinstance(data, list):
            return [self._changed(value, document, (*place, i)) for i, value in enumerate(data)]
        return data

    def _laid(self, name: str, document: Document, place: tuple[str | int, ...]) -> str:
        """Lay the upload of that name into the folder; its path from there."""
        found = (
            [name] if name in self._uploads else [n for n in self._uploads if base_name(n) == base_name(name)]
        )
        if len(found) != 1:
            self._faults.append(self._not_uploaded(name, bool(found), document, place))
            return NOWHERE
        source = self._uploads[found[0]]
        suffix = Path(base_name(found[0])).suffix
        laid = f"files/{source.name[:16]}{suffix.lower() if _SUFFIX.fullmatch(suffix) else ''}"
        if not (self._folder / laid).exists():
            _link_or_copy(source, self._folder / laid)
        self._names[str(self._folder / laid)] = found[0]
        return laid

    def _not_uploaded(self, name: str, many: bool, document: Document, place: tuple[str | int, ...]) -> Issue:
        field = ".".join(str(step) for step in place)
        have = ", ".join(repr(one[:80]) for one in sorted(self._uploads)[:10]) or "no files"
        what = f"{'several uploads are' if many else 'no upload is'} called {base_name(name)[:80]!r}"
        inner = place[1:] if document is self._cell else place
        return Issue(
            "service.not_uploaded",
            f"{field}: got {name[:80]!r}, {what}; with the problem came {have}",
            file=str(document.path),
            line=document.line(inner),
            field=field,
            hint="upload the file with the problem, under the name that the problem says",
        )


def base_name(name: str) -> str:
    """The last step of a file name, whatever system wrote it."""
    return re.split(r"[/\\]", name)[-1]


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        target.hardlink_to(source)
    except OSError:  # on another disk
        shutil.copyfile(source, target)


@dataclasses.dataclass(frozen=True)
class Examined:
    """What is known of an upload. Where it can be read: ``text``, the problem as it stands alone, ``files``
    {name in it: SHA-256}, its ``name``, ``digest``, ``processes`` and ``summary``; else errors alone."""

    issues: tuple[Issue, ...]
    name: str = ""
    digest: str = ""
    processes: tuple[str, ...] = ()
    text: str = ""
    files: Mapping[str, str] = dataclasses.field(default_factory=dict)
    summary: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    shapes: tuple[Mapping[str, Any], ...] = ()

    @property
    def readable(self) -> bool:
        """Whether the problem can be planned, as far as its file says."""
        return bool(self.text)
