"""Time bar of the replay: its time, its segments, and the mapping from the clock of the programs."""

import html
import json
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from planner.claims.segments import WORKING_KINDS, Segment
from planner.geometry.arrays import FloatArray
from planner.report.scene import MOTION_TIME, SETUP_SEGMENT, TRAVEL_TIME, Keyframes

_SEGMENT_COLOURS: Final = {
    **dict.fromkeys(WORKING_KINDS, "#f08a3c"),
    "approach": "#58a6c7",
    "retreat": "#58a6c7",
    "link": "#58a6c7",
    "transit": "#7d9fc0",
    "entry": "#aab4c0",
    "exit": "#aab4c0",
    "setup": "#c9a2c4",
}
"""Colours of the time bar by kind of segment."""
_OTHER_COLOUR: Final = "#8d99a8"
"""Colour of the time bar for all other kinds of segments."""
Clock = tuple[tuple[float, float], ...]
"""Corresponding times of the programs and of the replay [s], ascending, with linear interpolation."""


def time_bar(name: str, run: Keyframes, clock: Clock = (), motion_time: float | None = None) -> str:
    """Return the HTML of the bar for a replay that starts at time 0, with the times that its script needs.

    ``#t=seconds`` in the address stops there, also when it changes. ``#at=`` is a time on the clock of the
    programs, which ``clock`` maps. ``#work=`` is a time from the start of the work of the operation with
    the segment ``in=``.

    Args:
        name: Name of the problem.
        run: Keyframes.
        clock: Mapping from the clock of the programs.
        motion_time: Motion time that the report states [s]. If stated, the bar splits its own time into this
            time and the rest.
    """
    time = run.time - run.time[0]
    end = float(max(time[-1], 1e-3))
    data = {
        "end": round(end, 3),
        "segments": [
            (a, b, str(segment), colour) for a, b, segment, colour in _segment_runs(time, run.segment)
        ],
        "clock": [(round(a, 3), round(b, 3)) for a, b in clock],
        "stops": [(round(at - float(run.time[0]), 3), text) for at, text in run.stops],
    }
    # the speed that plays the replay in about 45 s
    first_speed = min((1, 2, 4, 8, 16, 32), key=lambda v: abs(np.log(end / v / 45.0)))
    options = "".join(
        f'<option value="{v}"{" selected" if v == first_speed else ""}>{v:g} ×</option>'
        for v in (0.5, 1, 2, 4, 8, 16, 32)
    )
    return (
        "<div id='bar'><div class='row'>"
        "<button type='button' id='play' title='Play or pause (space)' aria-label='Play'>▶</button>"
        "<div class='line'><div class='lane' aria-hidden='true'></div>"
        f"<input type='range' id='time' min='0' max='{end:.3f}' step='any' value='0' aria-label='Time'></div>"
        f"<select id='speed' title='Speed' aria-label='Speed of the replay'>{options}</select></div>"
        f"<div class='say'><b>{html.escape(name)}</b><span><span class='time'></span>"
        f"{_time_parts(end, run, motion_time)}</span>"
        "<span><i></i><span class='segment'></span></span>"
        "<span class='stopped' role='status'></span></div></div>"
        f"{embed_json('track', data)}"
    )


def embed_json(name: str, data: Any) -> str:
    """Return the HTML of data that a script of the page reads by the id ``name``."""
    packed = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f"<script type='application/json' id='{name}'>{packed}</script>"


def _time_parts(end: float, run: Keyframes, motion_time: float | None) -> str:
    """Return the parts of the duration ``end`` [s] of a replay as text, or nothing without a rest.

    They are the report's ``motion_time`` [s], the travel of external axes, and the rest.
    """
    if motion_time is None or end - motion_time < 0.05:
        return ""
    rest_name = "approach and retreat"
    rest_name += " and changes of setup" if SETUP_SEGMENT in run.segment else ""
    travel = f"{_format_clock(run.travel)} {TRAVEL_TIME}, " if run.travel else ""
    rest_time = end - motion_time - run.travel
    return f": {_format_clock(motion_time)} {MOTION_TIME}, {travel}{_format_clock(rest_time)} {rest_name}"


def _format_clock(seconds: float) -> str:
    """Format a time as in the bar: minutes, and seconds to a tenth."""
    tenths = round(10.0 * seconds)
    return f"{tenths // 600}:{tenths % 600 / 10:04.1f}"


def replay_clock(run: Keyframes, time: FloatArray, labels: Sequence[str]) -> Clock:
    """Return corresponding times of the programs and of the replay.

    Segments with the same label start and end together in both, and so does the whole. The replay shows
    approach and retreat at its own speed, so the clocks differ by more than an offset.

    Args:
        run: Keyframes.
        time: Times of the programs (S,) [s].
        labels: Keys of segments (S,).

    Returns:
        Pairs of times [s]. Empty if no segment is in both.
    """
    remaining_runs = [
        (shown_segment, a, b) for a, b, shown_segment, _ in _segment_runs(run.time - run.time[0], run.segment)
    ]
    out: list[tuple[float, float]] = []
    for label, first, last in _label_runs(labels):
        index = next(
            (i for i, shown_segment in enumerate(remaining_runs) if shown_segment[0].key == label), None
        )
        if index is not None:
            _, start, end = remaining_runs[index]
            remaining_runs = remaining_runs[index + 1 :]
            out += [(float(time[max(first - 1, 0)]), start), (float(time[last]), end)]
    if not out:
        return ()
    return ((float(time[0]), 0.0), *out, (float(time[-1]), float(run.time[-1] - run.time[0])))


def _label_runs(labels: Sequence[str]) -> list[tuple[str, int, int]]:
    """Return label, first and last index of each run of equal labels."""
    edges = [i for i in range(1, len(labels)) if labels[i] != labels[i - 1]]
    return [
        (str(labels[a]), a, b - 1)
        for a, b in zip([0, *edges], [*edges, len(labels)], strict=True)
        if len(labels)
    ]


def _segment_runs(time: np.ndarray, segments: tuple[Segment, ...]) -> list[tuple[float, float, Segment, str]]:
    """Return start, end [s], segment and colour of each run of keyframes with the same segment.

    A segment belongs to the path to its keyframe, so that a run starts at the keyframe before it.
    """
    out: list[tuple[float, float, Segment, str]] = []
    for i in range(1, len(segments)):
        a, b = round(float(time[i - 1]), 3), round(float(time[i]), 3)
        if out and out[-1][2] == segments[i]:
            out[-1] = (out[-1][0], b, *out[-1][2:])
        else:
            out.append((a, b, segments[i], _SEGMENT_COLOURS.get(segments[i].kind, _OTHER_COLOUR)))
    return out
