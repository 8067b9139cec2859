"""How far an element is made: which panels are cut, glued or broken, what to cut next, and from what a broken
one is cut again.

``progress.csv`` lies beside ``element.json`` and is no part of what `tandem element` writes, so it stays
where an element is divided again. A row has the panel's id, its state, and the size of its block when it was
marked, which tells panels that were another shape then.

A job of a raw block may be marked as well: one that cuts panels together stands for all of these, one that
cuts the block apart has a row of its own, with the size of its part.
"""

import csv
import dataclasses
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, get_args

from planner.element import stock_list
from planner.element.assembly import in_order
from planner.element.nested_output import AGAIN
from planner.element.output import table
from planner.element.stock_list import LeftOver
from planner.files import is_file, no_file
from planner.geometry.nesting import Block, Box, fits
from planner.geometry.units import MM
from planner.issues import Issue, Severity, refusal

State = Literal["cut", "glued", "broken"]
"""What a panel can be; one that is in no row is open."""
FILE: Final = "progress.csv"
_COLUMNS: Final = ("id", "state", "block_mm")
_MOST_NAMED: Final = 8  # panels of a block that are still to be cut
_OPEN: Final = "open"
_OF_JOB: Final[Mapping[str, tuple[str, ...]]] = {
    "cut": (_OPEN,),
    "glued": (_OPEN, "cut"),
    "broken": (_OPEN, "cut"),
    "open": ("cut",),
}
"""Panels that the mark of a job changes, by their states: what is farther than it keeps its own mark."""


@dataclasses.dataclass(frozen=True)
class Progress:
    """An element's ``data`` and the ``rows`` of its panels: state and block [mm] by id, in no order."""

    data: Mapping[str, Any]
    rows: Mapping[str, tuple[State, str]]

    def state(self, name: str) -> State | None:
        """The state of a panel; None where it is open."""
        return self.rows[name][0] if name in self.rows else None

    def to_cut(self, names: Sequence[str]) -> list[str]:
        """Those that are in no row."""
        return [name for name in names if name not in self.rows]

    def job_state(self, job: Mapping[str, Any]) -> Literal["cut"] | None:
        """``cut`` where a job of a raw block is done: that of panels when none of them is to be cut; None
        where it is open."""
        names = job.get("panels", (str(job["id"]),))
        return None if self.to_cut(list(names)) else "cut"


def read(out: Path) -> Progress:
    """The element in ``out`` and how far it is. Raises ``TandemError``: ``element.mark`` where there is no
    element or the list is none."""
    path = out / "element.json"
    if not is_file(path):
        hint = "tandem element FILE -o OUT writes it"
        raise refusal("element.mark", f"{path}: {no_file(path)}", file=str(path), hint=hint)
    data = json.loads(path.read_text("utf-8"))
    path = out / FILE
    rows: dict[str, tuple[State, str]] = {}
    given = path.read_text("utf-8-sig", errors="replace") if is_file(path) else ""
    for line, row in enumerate(csv.DictReader(io.StringIO(given, newline="")), 2):
        if tuple(row) != _COLUMNS or row["state"] not in get_args(State):
            what = f"got {row}, allowed are the columns {', '.join(_COLUMNS)} and the states "
            what += ", ".join(get_args(State))
            hint = "correct that line, or take it out: its panel counts as open then"
            raise refusal("element.mark", what, file=str(path), line=line, hint=hint)
        state: State = row["state"]  # type: ignore[assignment]
        rows[row["id"]] = state, row["block_mm"]
    return Progress(data, rows)


def block_jobs(data: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """The jobs of raw blocks of an element's data by their ids, each with its ``block``, in the order in
    which a block is cut."""
    return {
        str(job["id"]): {**job, "block": str(block["id"])}
        for block in (data.get("blocks") or {}).get("blocks", ())
        for job in block.get("jobs", ())
    }


def marked(found: Progress, name: str, state: State | Literal["open"]) -> Progress:
    """The same with one panel in that state, or without its mark; or with the panels of a job, as far as the
    mark is news of them. Raises ``TandemError``: ``element.mark`` for an id that the element does not have,
    or a state that a job cannot have."""
    rows = dict(found.rows)
    panels = {str(one["id"]): one for one in found.data["panels"]}
    jobs = block_jobs(found.data)
    job = jobs.get(name)
    if name not in panels and job is None and (state != _OPEN or name not in rows):
        known = list(panels)
        what = (
            f"got panel {name!r}, {found.data['name']} has {len(known)} panels from {known[0]} to {known[-1]}"
        )
        what += f" and {len(jobs)} jobs of raw blocks" if jobs else ""
        raise refusal("element.mark", what, field="panel", hint="see the ids in element.html")
    if job is not None and "panels" in job:
        rows.pop(name, None)  # it cut the block apart, as the element was divided before
        meant = [one for one in job["panels"] if (found.state(one) or _OPEN) in _OF_JOB[state]]
    elif job is not None and state not in ("cut", _OPEN):
        what = f"got {state} for {name}, a job that cuts block {job['block']} apart; allowed are cut and open"
        hint = "mark the panels that are to come out of it"
        raise refusal("element.mark", what, field="state", hint=hint)
    else:
        meant = [name]
    for one in meant:
        rows.pop(one, None)
        if state != _OPEN:
            rows[one] = state, _part_mm(job) if one == name and job is not None else _block_mm(panels[one])
    return dataclasses.replace(found, rows=rows)


def text(found: Progress) -> str:
    """``progress.csv``: panels in the order of the element, jobs, then those that it has no more."""
    known = [*(str(panel["id"]) for panel in found.data["panels"]), *block_jobs(found.data)]
    order = [name for name in known if name in found.rows]
    order += sorted(found.rows.keys() - set(known))
    return table([dict(zip(_COLUMNS, (name, *found.rows[name]), strict=True)) for name in order])


def issues(found: Progress) -> tuple[Issue, ...]:
    """``element.mark`` for marks of panels that the element has no more, or that have another size now."""
    blocks = {name: _part_mm(job) for name, job in block_jobs(found.data).items()}
    blocks |= {str(panel["id"]): _block_mm(panel) for panel in found.data["panels"]}
    gone = sorted(found.rows.keys() - blocks.keys())
    other = [name for name, (_, size) in found.rows.items() if blocks.get(name, size) != size]
    out = []
    for names, said in (
        (gone, "are none of the element's"),
        (sorted(other), "have blocks of another size now"),
    ):
        if names:
            what = f"{len(names)} panels or jobs that are marked {said}: {', '.join(names)}"
            hint = "the element was divided anew since: see to these panels, then mark them again, or open "
            hint += "to take their marks away"
            out.append(Issue("element.mark", what, Severity.WARNING, file=FILE, hint=hint))
    return tuple(out)


def _block_mm(panel: Mapping[str, Any]) -> str:
    return " x ".join(f"{float(panel[f'block_{axis}_mm']):g}" for axis in "xyz")


def _part_mm(job: Mapping[str, Any]) -> str:
    return " x ".join(f"{float(v):g}" for v in job["size_mm"])


def told(found: Progress, out: Path) -> Iterator[str]:
    """How far the element is, what to cut next, what to put in next, and from what broken panels are cut
    again, in lines. Raises ``TandemError``: ``element.stock`` where the list in ``out`` is none."""
    names = [str(panel["id"]) for panel in found.data["panels"]]
    count = {state: sum(found.state(name) == state for name in names) for state in get_args(State)}
    left = found.to_cut(names)
    yield (
        f"{found.data['name']}: of {len(names)} panels {count['glued']} are glued, {count['cut']} cut, "
        f"{count['broken']} broken, {len(left)} to be cut"
    )
    yield from _next_cut(found, left)
    order = [str(panel["id"]) for panel in in_order(found.data)]
    waiting = next((k for k, name in enumerate(order) if found.state(name) != "glued"), None)
    if waiting is not None:
        state = found.state(order[waiting])
        ready = "it is cut" if state == "cut" else f"it is {state or 'not cut yet'}"
        yield f"next to be glued: {order[waiting]}, {waiting + 1} of {len(order)} in order; {ready}"
    yield from _again(found, out)


def _next_cut(found: Progress, left: Sequence[str]) -> Iterator[str]:
    """The first block that is begun and not done, else the first with panels to cut; without blocks, the
    first panel."""
    nest = found.data.get("blocks")
    if not left:
        return
    if not nest:
        yield f"next to be cut: {left[0]}"
        return
    blocks = [(block, [str(one["id"]) for one in block["panels"]]) for block in nest["blocks"]]
    begun = [b for b in blocks if len(found.to_cut(b[1])) < len(b[1]) or any(_apart(found, b[0])[1])]
    block, own = next(b for b in (*begun, *blocks) if found.to_cut(b[1]))
    rest = found.to_cut(own)
    first, said = _job_next(found, block, rest)
    of = f"left over {block['left_over']}" if block["left_over"] else "a raw block"
    size = " x ".join(f"{v:g}" for v in block["size_mm"])
    more = [one for one in rest if one not in first]
    named = more[: max(_MOST_NAMED - len(first), 1)]
    after = f", then {', '.join(named)}" if named else ""
    after += f" and {len(more) - len(named)} more" if len(more) > len(named) else ""
    together = f"{', '.join(first)}{' together' if len(first) > 1 else ''}"
    yield f"next to be cut: {together}{after} of block {block['id']} ({of} of {size} mm){said}"


def _job_next(found: Progress, block: Mapping[str, Any], rest: Sequence[str]) -> tuple[list[str], str]:
    """The panels of a block that one job cuts next, and which jobs of the block come before."""
    row = next((job for job in block.get("jobs", ()) if rest[0] in job.get("panels", ())), None)
    left, done = _apart(found, block)
    whole = len(rest) == len(block["panels"])  # else who marks panels alone has cut it apart
    said = f"; before that, what cuts it apart: {', '.join(left)}" if left and (done or whole) else ""
    if row is None:
        return [rest[0]], said
    return [one for one in rest if one in row["panels"]], f", by job {row['id']}{said}"


def _apart(found: Progress, block: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """The jobs that cut a block apart: those that are left, and those that are done."""
    names = [str(job["id"]) for job in block.get("jobs", ()) if "panels" not in job]
    return found.to_cut(names), [name for name in names if name in found.rows]


def _again(found: Progress, out: Path) -> Iterator[str]:
    """For each broken panel, in the order of ids, a piece left over that its block fits into and no other one
    takes: the smallest one of blocks that are cut, or of those that are still to be cut; else a new raw
    block."""
    broken = [panel for panel in found.data["panels"] if found.state(str(panel["id"])) == "broken"]
    nest = found.data.get("blocks")
    if nest is None:
        for panel in broken:
            yield f"{panel['id']} again: from another block of {panel['raw_block_mm']} mm"
        return
    pieces = list(stock_list.read(out / "stock.csv")) if broken else []
    of = {one["id"]: block for block in nest["blocks"] for one in block["panels"]}
    more = float(nest["oversize_mm"]) * MM
    rows = {name for job in block_jobs(found.data).values() for name in job.get("panels", ())}
    uncut = [block["id"] for block in nest["blocks"] if found.to_cut([one["id"] for one in block["panels"]])]

    def later(piece: LeftOver) -> str:
        """The block that must be cut before there is such a piece."""
        made = (name for name in uncut if piece.name.startswith(f"{found.data['name']}-{name}-"))
        return next(made, "")

    for panel in broken:
        block = of[panel["id"]]
        x, y, z = (float(panel[f"block_{axis}_mm"]) * MM for axis in "xyz")
        box = Box(x + more, y + more, z)
        fit = [
            one for one in pieces if one.foam == block["foam"] and fits(box, _as_block(one), nest["turned"])
        ]
        wanted = f"{panel['id']} again, {(x + more) / MM:g} x {(y + more) / MM:g} x {z / MM:g} mm: from "
        if fit:
            best = min(
                fit, key=lambda one: (bool(later(one)), one.length * one.width * one.thickness, one.name)
            )
            pieces.remove(best)
            size = " x ".join(f"{round(v / MM, 1):g}" for v in (best.length, best.width, best.thickness))
            when = f", once {later(best)} is cut" if later(best) else ""
            source = f"what is left over, {best.name} ({size} mm){when}"
        else:
            size = " x ".join(f"{v:g}" for v in block["size_mm"])
            source = f"a raw block of {size} mm, as {block['id']} was: nothing left over holds it"
        alone = f"; by itself, {AGAIN}/{panel['id']}.yaml" if panel["id"] in rows else ""
        yield f"{wanted}{source}{alone}"


def _as_block(piece: LeftOver) -> Block:
    return Block(piece.length, piece.width, piece.thickness)
