"""The process ``targets``: synchronised poses for one or two arms from a table in a CSV or JSON file."""

import csv
import io
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from planner.claims.claim import Claim
from planner.claims.dialogue import OperatorDialogue
from planner.claims.segments import Segment
from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import FloatArray, from_parts, from_quaternion
from planner.geometry.units import DEG, MM
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.problem import Stock
from planner.processes.poses import claims
from planner.reading.strict_yaml import Name, Strict
from planner.reading.values import POSE_COLUMNS, ROW_COLUMNS
from planner.targets import Job, ScrewFreedom, Targets

MAX_TABLE_BYTES = 100_000_000
"""Maximum size of a table of poses [bytes]. Larger files are refused unread."""
MAX_COORDINATE_MM = 100_000.0
"""Maximum coordinate of a position [mm]. Larger values indicate that the unit is not mm."""
MIN_FEED_MM_S, MAX_FEED_MM_S = 0.1, 10_000.0
"""Bounds of feeds [mm/s]."""
MAX_MIN_FEED_FRACTION = 0.95
"""Maximum of a minimum feed, as a fraction of the feed, because plans keep a margin below the feed."""
REST_DISTANCE_M = 1e-6
"""A tool that moves at most this distance [m] is at rest."""
SEGMENT_LABEL = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}(/[A-Za-z0-9_]{1,32})?")
"""Form of a segment's label: its kind, and optionally a name after a slash."""
FLAG_WORDS = {"": False, "0": False, "false": False, "no": False, "1": True, "true": True, "yes": True}
"""Words of the column ``stop`` and whether they mean a stop."""
AXIS_INDEX = {"x": 0, "y": 1, "z": 2}
"""Index of each axis of a tool frame."""


class FreeAxis(Strict):
    """A free rotation about, or translation along, an axis of the tool frame.

    Two arms in ``arms`` share its value.
    """

    name: str
    arms: list[str] = Field(min_length=1, max_length=2)
    axis: Literal["x", "y", "z"]
    turn_deg: tuple[float, float] | None = None
    slide_mm: tuple[float, float] | None = None

    @model_validator(mode="after")
    def _check_bounds(self) -> "FreeAxis":
        for bounds in (self.turn_deg, self.slide_mm):
            if bounds is not None and bounds[0] > bounds[1]:
                raise ValueError("turn_deg and slide_mm are [lower, upper] with lower <= upper")
        return self


class Posed(Strict):
    """Poses from a file.

    CSV columns: for each arm ``<arm>.x_mm, .y_mm, .z_mm, .qw, .qx, .qy, .qz``, and ``feed_mm_s``. Optional
    columns are ``feed_min_mm_s``, ``segment`` and ``stop``. JSON: a list of objects with the same keys.
    ``segment`` is a kind, or ``kind/name``, of letters, digits and ``_``, such as ``cut/front``.
    """

    name: Name
    process: Literal["targets"]
    arms: tuple[str, ...] = Field(min_length=1, max_length=2)
    file: Path
    frame: Literal["stock", "world"] = "stock"
    free: tuple[FreeAxis, ...] = ()
    feed_mm_s: Annotated[float, Field(ge=MIN_FEED_MM_S, le=MAX_FEED_MM_S)] | None = None
    feed_min_mm_s: float = Field(
        default=0.0, ge=0, le=MAX_FEED_MM_S, description="minimum; a slower tool is refused; 0: none"
    )
    run_up_mm: float = Field(
        default=5.0, gt=0, le=1000, description="length from and to stops over which the tool reaches it"
    )
    coupled: bool = False
    position_tol_mm: float = Field(default=0.01, gt=0)
    angle_tol_deg: float = Field(default=0.01, gt=0)

    @field_validator("file")
    @classmethod
    def _resolve_file(cls, value: Path, info: ValidationInfo) -> Path:
        folder: Path = (info.context or {}).get("folder", Path())
        return folder / value

    any_lean: ClassVar[bool] = True
    """Targets and claims do not depend on the tilt of the block."""
    any_base: ClassVar[bool] = True
    """Targets and claims do not depend on the pose of the arm's base."""

    def leaves(self, stock: Stock) -> Stock:
        """Return the block unchanged, because what is cut stays in its place."""
        return stock

    @model_validator(mode="after")
    def _check_consistency(self) -> "Posed":
        """Require that the fields do not contradict one another."""
        if len(set(self.arms)) != len(self.arms):
            raise ValueError("arms: each arm is named once")
        names = [axis.name for axis in self.free]
        if len(set(names)) != len(names):
            raise ValueError("free: two axes have one name; rename one")
        for axis in self.free:
            if not set(axis.arms) <= set(self.arms) or len(set(axis.arms)) != len(axis.arms):
                raise ValueError(f"free: axis '{axis.name}' must name arms of this operation, each once")
        if self.feed_mm_s is not None and self.feed_min_mm_s > MAX_MIN_FEED_FRACTION * self.feed_mm_s:
            raise ValueError(f"feed_min_mm_s must not exceed {MAX_MIN_FEED_FRACTION:g} of feed_mm_s")
        return self


class PosedJob(Job[Posed]):
    """Job of an operation that follows the poses of a file."""

    def targets(self) -> Targets:
        """Return the targets of the operation's file, one for each row, from which the arms' paths follow.

        The tools stop at the first and the last target, whatever the file says there.

        Raises:
            TandemError: The first fault of the file, with its row; ``targets.freedom`` for unsuitable free
                axes; ``targets.held`` if an arm holds the block.
        """
        operation, setup = self.operation, self.setup
        if setup.stock.held_by is not None:
            message = format_message("targets.held", operation=operation.name, arm=setup.stock.held_by)
            raise issue_error("targets.held", message, field="operations.process", arm=setup.stock.held_by)
        rows = _read_rows(operation)
        poses = {arm: _parse_poses(rows, arm, operation) for arm in operation.arms}
        count = len(rows)
        feed = np.array(
            [_parse_number(row, "feed_mm_s", i, operation, operation.feed_mm_s) for i, row in enumerate(rows)]
        )
        if not ((feed >= MIN_FEED_MM_S) & (feed <= MAX_FEED_MM_S)).all():
            first = int(np.argmax((feed < MIN_FEED_MM_S) | (feed > MAX_FEED_MM_S)))
            raise TandemError(
                _table_issue(
                    operation,
                    first,
                    f"feed_mm_s is {feed[first]:g}, allowed {MIN_FEED_MM_S:g} to {MAX_FEED_MM_S:g}; correct "
                    "it",
                )
            )
        segment = tuple(_parse_segment(row, i, operation) for i, row in enumerate(rows))
        stop = np.array([_parse_flag(row, i, operation) for i, row in enumerate(rows)])
        stop[[0, -1]] = True  # the tools start and end at rest
        travel = _travel_lengths(poses)
        min_feed = _min_feeds(rows, operation, feed, travel, segment)
        return Targets(
            arms=operation.arms,
            pose=poses,
            frame=dict.fromkeys(operation.arms, operation.frame),
            freedoms=tuple(_screw_freedom(axis, count) for axis in operation.free),
            feed=feed * MM,
            feed_min=min_feed * MM,
            travel=travel,
            stop=stop,
            segment=segment,
            coupled=operation.coupled,
            run_up=operation.run_up_mm * MM,
            claims=self.claims(),
            may_stop=True,
            feed_throughout=False,
        )

    def make_claims(self) -> tuple[Claim, ...]:
        """Return two claims: each TCP passes the poses of the file up to its free axes, and the dialogue.

        The first claim contains no poses, because the proof reads the file itself.
        """
        op = self.operation
        free = tuple(
            claims.FreeAxisRange(
                tuple(axis.arms),
                AXIS_INDEX[axis.axis],
                axis.turn_deg is not None,
                *(
                    bound * (DEG if axis.turn_deg else MM)
                    for bound in axis.turn_deg or axis.slide_mm or (0.0, 0.0)
                ),
            )
            for axis in op.free
        )
        feed = None if op.feed_mm_s is None else op.feed_mm_s * MM
        tolerance = (op.position_tol_mm * MM, op.angle_tol_deg * DEG)
        min_feed_and_run_up = (op.feed_min_mm_s * MM, op.run_up_mm * MM)
        return (
            claims.FollowsTable(op.name, op.arms, op.frame, free, *tolerance, feed, *min_feed_and_run_up),
            OperatorDialogue(op.arms, joined=op.coupled),
        )


def _travel_lengths(poses: Mapping[str, FloatArray]) -> FloatArray:
    """Return the lengths (N,) [m] of the moves to each target: those of the TCP that moves farthest.

    The length at the first target, to which no move leads, is 0.
    """
    steps = [np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1) for pose in poses.values()]
    return np.concatenate([[0.0], np.max(steps, axis=0)])


def _min_feeds(
    rows: list[Mapping[str, Any]],
    operation: Posed,
    feed: FloatArray,
    travel: FloatArray,
    segment: tuple[Segment, ...],
) -> FloatArray:
    """Return the minimum feeds (N,) [mm/s] of the moves to each target, 0 for none, and check them.

    The first target has none, because no move leads to it.

    Args:
        rows: Rows of the table, one for each target.
        operation: Operation with the minimum feed of rows without their own.
        feed: Feed (N,) [mm/s] of the move to each target.
        travel: Length (N,) [m] of the move to each target.
        segment: Segment of each target.

    Raises:
        TandemError: If a minimum feed is negative or too close to the feed, is set where the tools rest or
            only rotate, or in a transit of joined tools; ``targets.freedom`` if any is set while a free axis
            slides.
    """
    default = operation.feed_min_mm_s
    min_feed = np.array(
        [_parse_number(row, "feed_min_mm_s", i, operation, default) for i, row in enumerate(rows)]
    )
    min_feed[0] = 0.0
    is_coupled_transit = [operation.coupled and label.kind == "transit" for label in segment]
    faults = (
        (min_feed < 0.0, "is below 0; give 0 for none"),
        (
            min_feed > MAX_MIN_FEED_FRACTION * feed,
            f"is over {MAX_MIN_FEED_FRACTION:g} of the feed; lower it or raise feed_mm_s",
        ),
        ((min_feed > 0.0) & (travel < REST_DISTANCE_M), "is set where the tools rest or only rotate; give 0"),
        (
            (min_feed > 0.0) & np.array(is_coupled_transit),
            "is set in a transit of joined tools, whose path may be changed; give 0",
        ),
    )
    for is_faulty, fault in faults:
        if is_faulty.any():
            first = int(np.argmax(is_faulty))
            raise TandemError(_table_issue(operation, first, f"feed_min_mm_s of {min_feed[first]:g} {fault}"))
    slides = [axis.name for axis in operation.free if axis.slide_mm is not None]
    if slides and min_feed.any():
        message = (
            f"free axis '{slides[0]}' slides, which changes the tool's speed, but feed_min_mm_s sets a "
            "minimum speed; leave only rotations free, or remove feed_min_mm_s"
        )
        raise issue_error("targets.freedom", message, field="operations.free")
    return min_feed


def _twist(axis: FreeAxis) -> FloatArray:
    """Return the unit twist (6,) of a free axis in the tool frame, angular part first."""
    twist = np.zeros(6)
    twist[AXIS_INDEX[axis.axis] + (0 if axis.turn_deg is not None else 3)] = 1.0
    return twist


def _screw_freedom(axis: FreeAxis, count: int) -> ScrewFreedom:
    """Return a free axis, which must have either ``turn_deg`` or ``slide_mm``, as a freedom of targets."""
    if (axis.turn_deg is None) == (axis.slide_mm is None):
        message = f"free axis '{axis.name}': give either turn_deg or slide_mm, one of them"
        raise issue_error("targets.freedom", message, field="operations.free")
    bounds = axis.turn_deg or axis.slide_mm or (0.0, 0.0)
    scale = DEG if axis.turn_deg is not None else MM
    lower, upper = (np.full(count, bound * scale) for bound in bounds)
    periodic = axis.turn_deg is not None and bounds[1] - bounds[0] >= 360.0
    return ScrewFreedom(axis.name, dict.fromkeys(axis.arms, _twist(axis)), lower, upper, None, periodic)


def _read_rows(operation: Posed) -> list[Mapping[str, Any]]:
    """Read the rows of the operation's file, each as a mapping from the column's name to the cell.

    Raises:
        TandemError: If the file is missing, too large or unreadable, has fewer than two rows, or has unknown
            columns.
    """
    path = operation.file
    if not is_file(path):
        message = (
            f"{path}: {missing_file_reason(path)}; check the path, which starts at the problem file's folder"
        )
        raise issue_error("problem.missing_file", message, file=str(path), field="operations.file")
    if path.stat().st_size > MAX_TABLE_BYTES:
        message = f"{path}: over {MAX_TABLE_BYTES // 1_000_000} MB; split the job"
        raise issue_error("problem.too_large", message, file=str(path))
    try:
        text = path.read_bytes().decode("utf-8-sig")
        rows = json.loads(text) if path.suffix.lower() == ".json" else _parse_csv(text, operation)
    except (OSError, ValueError, RecursionError, csv.Error) as error:
        reason = str(error) or type(error).__name__
        raise TandemError(
            _table_issue(operation, None, f"cannot be read: {reason}; give CSV or JSON in UTF-8")
        ) from error
    if not isinstance(rows, list) or len(rows) < 2 or not all(isinstance(row, dict) for row in rows):
        raise TandemError(_table_issue(operation, None, "expected a list of at least 2 targets; add them"))
    allowed = {f"{arm}.{column}" for arm in operation.arms for column in POSE_COLUMNS} | set(ROW_COLUMNS)
    unknown = sorted({str(key) for row in rows for key in row} - allowed)
    if unknown:
        unknown_names, allowed_names = ", ".join(unknown[:5]), ", ".join(sorted(allowed))
        message = (
            f"unknown columns {unknown_names}; remove them or correct their spelling (known: {allowed_names})"
        )
        raise TandemError(_table_issue(operation, None, message))
    return rows


def _parse_csv(text: str, operation: Posed) -> list[Mapping[str, Any]]:
    """Return the rows of a CSV text, by column; empty lines are skipped.

    Raises:
        TandemError: If columns are separated by semicolons, a column occurs twice, or a row has another
            number of cells than the header.
        csv.Error: If the text is not valid CSV.
    """
    lines = [line for line in csv.reader(io.StringIO(text), strict=True) if any(map(str.strip, line))]
    header = [name.strip() for name in lines[0]] if lines else []
    if len(header) == 1 and ";" in header[0]:
        raise TandemError(_table_issue(operation, None, "columns are separated by semicolons; use commas"))
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated:
        raise TandemError(_table_issue(operation, None, f"column '{repeated[0]}' occurs twice; keep one"))
    for i, line in enumerate(lines[1:]):
        if len(line) != len(header):
            message = f"{len(line)} cells where the header has {len(header)}; correct the row"
            raise TandemError(_table_issue(operation, i, message))
    return [dict(zip(header, line, strict=True)) for line in lines[1:]]


def _parse_poses(rows: list[Mapping[str, Any]], arm: str, operation: Posed) -> FloatArray:
    """Return the poses (N, 4, 4) [m] of an arm from the rows of a table; faults raise `TandemError`."""
    table = np.array(
        [
            [_parse_number(row, f"{arm}.{column}", i, operation) for column in POSE_COLUMNS]
            for i, row in enumerate(rows)
        ]
    )
    norm = np.linalg.norm(table[:, 3:], axis=1)
    is_not_unit = np.abs(norm - 1.0) > 1e-3
    if is_not_unit.any():
        first = int(np.argmax(is_not_unit))
        raise TandemError(
            _table_issue(
                operation,
                first,
                f"{arm}: quaternion of length {norm[first]:.4f}, allowed 1 within 0.001; normalise it",
            )
        )
    is_too_far = (np.abs(table[:, :3]) > MAX_COORDINATE_MM).any(axis=1)
    if is_too_far.any():
        first = int(np.argmax(is_too_far))
        message = f"{arm}: a position beyond {MAX_COORDINATE_MM / 1000:g} m; give positions in mm"
        raise TandemError(_table_issue(operation, first, message))
    return from_parts(from_quaternion(table[:, 3:]), table[:, :3] * MM)


def _parse_number(
    row: Mapping[str, Any], column: str, index: int, operation: Posed, default: float | None = None
) -> float:
    """Return a finite number from row ``index``, or ``default`` for an empty cell, or raise `TandemError`."""
    value = row.get(column)
    if value in (None, "") and default is not None:
        return default
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        got = "nothing" if value in (None, "") else repr(value)[:40]
        raise TandemError(
            _table_issue(
                operation, index, f"column '{column}': got {got}; a finite number is needed, correct it"
            )
        )
    return number


def _parse_segment(row: Mapping[str, Any], index: int, operation: Posed) -> Segment:
    """Return the segment of row ``index``, or raise `TandemError`; an empty cell means ``cut/path``."""
    value = row.get("segment") or "cut/path"
    if not isinstance(value, str) or not SEGMENT_LABEL.fullmatch(value):
        message = f"segment is {repr(value)[:60]}; use <kind> or <kind>/<name> of letters, digits and _"
        raise TandemError(_table_issue(operation, index, message))
    return Segment.of(value)


def _parse_flag(row: Mapping[str, Any], index: int, operation: Posed) -> bool:
    """Return whether the tools stop at row ``index``, or raise `TandemError` for an unknown word."""
    value = row.get("stop")
    text = "" if value is None else str(value).strip().lower()
    if text not in FLAG_WORDS:
        raise TandemError(_table_issue(operation, index, f"stop is {repr(value)[:40]}; use true or false"))
    return FLAG_WORDS[text]


def _table_issue(operation: Posed, index: int | None, fault: str) -> Issue:
    """Return the issue of a fault in the operation's file, in row ``index`` or in the whole file."""
    row = "" if index is None else f", target {index}"
    message = format_message("targets.file", file=operation.file, row=row, fault=fault)
    return Issue("targets.file", message, file=str(operation.file), index=index)
