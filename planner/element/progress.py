"""Progress of an element: which panels are cut, glued or broken, what to cut next, and replacements.

``progress.csv`` lies next to ``element.json`` and is not written by `tandem element`, so it survives when an
element is divided again. A row has the id of the panel, its state, and the size of its block when it was
marked, which identifies panels that had another shape then.

A job of a raw block can be marked as well. If it cuts panels together, its mark sets the rows of these
panels. If it cuts the block apart, it has a row of its own, with the size of its part.
"""

import csv
import dataclasses
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, get_args

from planner.element import stock_list
from planner.element.assembly import panels_in_order
from planner.element.nested_output import REPLACEMENT_FOLDER
from planner.element.output import table
from planner.element.stock_list import Offcut
from planner.files import is_file, missing_file_reason
from planner.geometry.nesting import NestBlock, NestBox, box_fits
from planner.geometry.units import MM
from planner.issues import Issue, Severity, issue_error

PanelState = Literal["cut", "glued", "broken"]
"""State of a panel. Panels without a row are open."""
PROGRESS_FILE: Final = "progress.csv"
_COLUMNS: Final = ("id", "state", "block_mm")
_MAX_NAMED_PANELS: Final = 8  # of the panels of a block that are still to be cut
_OPEN: Final = "open"
_CHANGED_BY_JOB: Final[Mapping[str, tuple[str, ...]]] = {
    "cut": (_OPEN,),
    "glued": (_OPEN, "cut"),
    "broken": (_OPEN, "cut"),
    "open": ("cut",),
}
"""States of panels that the mark of a job changes. Panels that are further advanced keep their own mark."""


@dataclasses.dataclass(frozen=True)
class ElementProgress:
    """Progress of an element.

    Attributes:
        data: Content of ``element.json``.
        rows: State and size of the block [mm] as text, by id of a panel or job.
    """

    data: Mapping[str, Any]
    rows: Mapping[str, tuple[PanelState, str]]

    def state(self, name: str) -> PanelState | None:
        """Return the state of a panel; None if it is open."""
        return self.rows[name][0] if name in self.rows else None

    def to_cut(self, names: Sequence[str]) -> list[str]:
        """Return those of the panels or jobs that are open, and so have no row."""
        return [name for name in names if name not in self.rows]

    def job_state(self, job: Mapping[str, Any]) -> Literal["cut"] | None:
        """Return ``cut`` if a job of a raw block is done, None if it is open.

        A job that cuts panels together is done when none of them is open.
        """
        names = job.get("panels", (str(job["id"]),))
        return None if self.to_cut(list(names)) else "cut"


def read_progress(out: Path) -> ElementProgress:
    """Read ``element.json`` and ``progress.csv`` in the folder ``out``; without a list, all panels are open.

    Raises:
        TandemError: ``element.mark`` if there is no element or the list is invalid.
    """
    path = out / "element.json"
    if not is_file(path):
        hint = "tandem element FILE -o OUT writes it"
        raise issue_error("element.mark", f"{path}: {missing_file_reason(path)}", file=str(path), hint=hint)
    data = json.loads(path.read_text("utf-8"))
    path = out / PROGRESS_FILE
    rows: dict[str, tuple[PanelState, str]] = {}
    text = path.read_text("utf-8-sig", errors="replace") if is_file(path) else ""
    for line, row in enumerate(csv.DictReader(io.StringIO(text, newline="")), 2):
        if tuple(row) != _COLUMNS or row["state"] not in get_args(PanelState):
            message = f"got {row}, allowed columns {', '.join(_COLUMNS)} and states "
            message += ", ".join(get_args(PanelState))
            hint = "correct that line, or remove it: its panel then counts as open"
            raise issue_error("element.mark", message, file=str(path), line=line, hint=hint)
        state: PanelState = row["state"]  # type: ignore[assignment]
        rows[row["id"]] = state, row["block_mm"]
    return ElementProgress(data, rows)


def block_jobs(data: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the jobs of raw blocks by id, in cutting order, each with the id of its block as ``block``."""
    return {
        str(job["id"]): {**job, "block": str(block["id"])}
        for block in (data.get("blocks") or {}).get("blocks", ())
        for job in block.get("jobs", ())
    }


def mark(progress: ElementProgress, name: str, state: PanelState | Literal["open"]) -> ElementProgress:
    """Return the progress after a panel or job is marked.

    ``open`` removes a mark. The mark of a job that cuts panels together changes those of its panels that are
    in a state of `_CHANGED_BY_JOB`.

    Raises:
        TandemError: ``element.mark`` for an unknown id, or a state that a job cannot have.
    """
    rows = dict(progress.rows)
    panels = {str(panel["id"]): panel for panel in progress.data["panels"]}
    jobs = block_jobs(progress.data)
    job = jobs.get(name)
    if name not in panels and job is None and (state != _OPEN or name not in rows):
        known_ids = list(panels)
        message = (
            f"got panel {name!r}, {progress.data['name']} has {len(known_ids)} panels from {known_ids[0]} to "
            f"{known_ids[-1]}"
        )
        message += f" and {len(jobs)} jobs of raw blocks" if jobs else ""
        raise issue_error("element.mark", message, field="panel", hint="see the ids in element.html")
    if job is not None and "panels" in job:
        rows.pop(name, None)  # in an earlier division it cut the block apart
        panel_ids = [
            panel_id
            for panel_id in job["panels"]
            if (progress.state(panel_id) or _OPEN) in _CHANGED_BY_JOB[state]
        ]
    elif job is not None and state not in ("cut", _OPEN):
        message = f"got {state} for {name}, a job that cuts block {job['block']} apart; allowed: cut and open"
        hint = "mark the panels that are cut from it"
        raise issue_error("element.mark", message, field="state", hint=hint)
    else:
        panel_ids = [name]
    for panel_id in panel_ids:
        rows.pop(panel_id, None)
        if state != _OPEN:
            rows[panel_id] = (
                state,
                _part_mm(job) if panel_id == name and job is not None else _block_mm(panels[panel_id]),
            )
    return dataclasses.replace(progress, rows=rows)


def progress_csv(progress: ElementProgress) -> str:
    """Return ``progress.csv``: panels in the order of the element, jobs, then panels that no longer exist."""
    known = [*(str(panel["id"]) for panel in progress.data["panels"]), *block_jobs(progress.data)]
    order = [name for name in known if name in progress.rows]
    order += sorted(progress.rows.keys() - set(known))
    return table([dict(zip(_COLUMNS, (name, *progress.rows[name]), strict=True)) for name in order])


def progress_issues(progress: ElementProgress) -> tuple[Issue, ...]:
    """Return ``element.mark`` for marks of panels or jobs that no longer exist or have another size."""
    blocks = {name: _part_mm(job) for name, job in block_jobs(progress.data).items()}
    blocks |= {str(panel["id"]): _block_mm(panel) for panel in progress.data["panels"]}
    unknown = sorted(progress.rows.keys() - blocks.keys())
    resized = [name for name, (_, size) in progress.rows.items() if blocks.get(name, size) != size]
    out = []
    for names, phrase in (
        (unknown, "are not in the element"),
        (sorted(resized), "have blocks of another size now"),
    ):
        if names:
            message = f"{len(names)} panels or jobs that are marked {phrase}: {', '.join(names)}"
            hint = "the element was divided again: check these panels, then mark them again or mark them "
            hint += "open to remove their marks"
            out.append(Issue("element.mark", message, Severity.WARNING, file=PROGRESS_FILE, hint=hint))
    return tuple(out)


def _block_mm(panel: Mapping[str, Any]) -> str:
    """Return the size of a panel's block as text."""
    return " x ".join(f"{float(panel[f'block_{axis}_mm']):g}" for axis in "xyz")


def _part_mm(job: Mapping[str, Any]) -> str:
    """Return the size of the part of a raw block that a job cuts, as text."""
    return " x ".join(f"{float(v):g}" for v in job["size_mm"])


def progress_lines(progress: ElementProgress, out: Path) -> Iterator[str]:
    """Yield lines on the progress: counts, what to cut and install next, and replacements of broken panels.

    Raises:
        TandemError: ``element.stock`` if the list in ``out`` is invalid.
    """
    names = [str(panel["id"]) for panel in progress.data["panels"]]
    count = {state: sum(progress.state(name) == state for name in names) for state in get_args(PanelState)}
    open_panels = progress.to_cut(names)
    yield (
        f"{progress.data['name']}: of {len(names)} panels {count['glued']} are glued, {count['cut']} cut, "
        f"{count['broken']} broken, {len(open_panels)} to be cut"
    )
    yield from _next_cut(progress, open_panels)
    order = [str(panel["id"]) for panel in panels_in_order(progress.data)]
    k_next = next((k for k, name in enumerate(order) if progress.state(name) != "glued"), None)
    if k_next is not None:
        state = progress.state(order[k_next])
        words = "it is cut" if state == "cut" else f"it is {state or 'not cut yet'}"
        yield f"next to be glued: {order[k_next]}, {k_next + 1} of {len(order)} in order; {words}"
    yield from _replacement_lines(progress, out)


def _next_cut(progress: ElementProgress, open_panels: Sequence[str]) -> Iterator[str]:
    """Yield the line that states what to cut next; no line if ``open_panels`` is empty.

    It is the first block that is begun and not done, else the first one with open panels. Without raw blocks,
    it is the first open panel.
    """
    nest = progress.data.get("blocks")
    if not open_panels:
        return
    if not nest:
        yield f"next to be cut: {open_panels[0]}"
        return
    blocks = [(block, [str(panel["id"]) for panel in block["panels"]]) for block in nest["blocks"]]
    begun = [
        (block, ids)
        for block, ids in blocks
        if len(progress.to_cut(ids)) < len(ids) or any(_separating_jobs(progress, block)[1])
    ]
    block, panel_ids = next((block, ids) for block, ids in (*begun, *blocks) if progress.to_cut(ids))
    rest = progress.to_cut(panel_ids)
    first, job_text = _job_next(progress, block, rest)
    source = f"left over {block['left_over']}" if block["left_over"] else "a raw block"
    size = " x ".join(f"{v:g}" for v in block["size_mm"])
    others = [panel_id for panel_id in rest if panel_id not in first]
    named_panels = others[: max(_MAX_NAMED_PANELS - len(first), 1)]
    then = f", then {', '.join(named_panels)}" if named_panels else ""
    then += f" and {len(others) - len(named_panels)} more" if len(others) > len(named_panels) else ""
    together = f"{', '.join(first)}{' together' if len(first) > 1 else ''}"
    yield f"next to be cut: {together}{then} of block {block['id']} ({source} of {size} mm){job_text}"


def _job_next(
    progress: ElementProgress, block: Mapping[str, Any], rest: Sequence[str]
) -> tuple[list[str], str]:
    """Return the panels of a block that are cut next, and the text that names their job and those before it.

    ``rest`` are the open panels of the block, in the order in which they are cut.
    """
    row = next((job for job in block.get("jobs", ()) if rest[0] in job.get("panels", ())), None)
    open_jobs, done = _separating_jobs(progress, block)
    # if some panels are cut already, the block was cut apart, even if its jobs are not marked
    is_whole = len(rest) == len(block["panels"])
    suffix = (
        f"; before that, what cuts it apart: {', '.join(open_jobs)}"
        if open_jobs and (done or is_whole)
        else ""
    )
    if row is None:
        return [rest[0]], suffix
    return [panel_id for panel_id in rest if panel_id in row["panels"]], f", by job {row['id']}{suffix}"


def _separating_jobs(progress: ElementProgress, block: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Return the ids of the jobs that cut a block apart: the open ones, and those that are done."""
    names = [str(job["id"]) for job in block.get("jobs", ()) if "panels" not in job]
    return progress.to_cut(names), [name for name in names if name in progress.rows]


def _replacement_lines(progress: ElementProgress, out: Path) -> Iterator[str]:
    """Yield a line for each broken panel, in the order of ids, that states the foam for its replacement.

    It is the smallest offcut that holds the panel's block and that no other broken panel takes, preferably
    one that exists already, else one of a block that is still to be cut. If there is none, it is a new raw
    block.
    """
    broken = [panel for panel in progress.data["panels"] if progress.state(str(panel["id"])) == "broken"]
    nest = progress.data.get("blocks")
    if nest is None:
        for panel in broken:
            yield f"{panel['id']} again: from another block of {panel['raw_block_mm']} mm"
        return
    offcuts = list(stock_list.read_offcuts(out / "stock.csv")) if broken else []
    block_by_panel = {item["id"]: block for block in nest["blocks"] for item in block["panels"]}
    oversize = float(nest["oversize_mm"]) * MM
    panels_in_rows = {name for job in block_jobs(progress.data).values() for name in job.get("panels", ())}
    uncut = [
        block["id"] for block in nest["blocks"] if progress.to_cut([item["id"] for item in block["panels"]])
    ]

    def uncut_block(piece: Offcut) -> str:
        """Return the id of the block that must be cut before this offcut exists; empty if it exists."""
        earlier_blocks = (name for name in uncut if piece.name.startswith(f"{progress.data['name']}-{name}-"))
        return next(earlier_blocks, "")

    for panel in broken:
        block = block_by_panel[panel["id"]]
        x, y, z = (float(panel[f"block_{axis}_mm"]) * MM for axis in "xyz")
        box = NestBox(x + oversize, y + oversize, z)
        fitting = [
            item
            for item in offcuts
            if item.foam == block["foam"] and box_fits(box, _as_block(item), nest["turned"])
        ]
        prefix = (
            f"{panel['id']} again, {(x + oversize) / MM:g} x {(y + oversize) / MM:g} x {z / MM:g} mm: from "
        )
        if fitting:
            best = min(
                fitting,
                key=lambda item: (
                    bool(uncut_block(item)),
                    item.length * item.width * item.thickness,
                    item.name,
                ),
            )
            offcuts.remove(best)
            size = " x ".join(f"{round(v / MM, 1):g}" for v in (best.length, best.width, best.thickness))
            condition = f", once {uncut_block(best)} is cut" if uncut_block(best) else ""
            source = f"offcut {best.name} ({size} mm){condition}"
        else:
            size = " x ".join(f"{v:g}" for v in block["size_mm"])
            source = f"a raw block of {size} mm, as {block['id']}: no offcut is large enough"
        problem_text = (
            f"; alone, {REPLACEMENT_FOLDER}/{panel['id']}.yaml" if panel["id"] in panels_in_rows else ""
        )
        yield f"{prefix}{source}{problem_text}"


def _as_block(piece: Offcut) -> NestBlock:
    return NestBlock(piece.length, piece.width, piece.thickness)
