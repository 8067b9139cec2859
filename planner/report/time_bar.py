"""The bar of the replay: its time, what it consists of, and how the programs' clock leads to it."""

import html
import json
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from planner.claims.segments import WORKING_KINDS, Segment
from planner.geometry.arrays import FloatArray
from planner.report.scene import MOTION_TIME, SETUP_SEGMENT, TRAVEL_TIME, Track

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
"""Colour of the time bar for every other kind of segment."""
Clock = tuple[tuple[float, float], ...]
"""Times of the programs and of the replay [s] that belong together, ascending; straight between them."""


def time_bar(name: str, run: Track, clock: Clock = (), motion_time: float | None = None) -> str:
    """HTML of the bar for a replay that starts at time 0, and the times that its script needs; with
    ``motion_time`` [s], which the report states, it says how much of its own time is what.

    ``#t=seconds`` in the address stops there, also when it changes; ``#at=`` is a time on the programs'
    clock, which ``clock`` leads over; ``#work=`` one from the start of the work of the operation that has the
    segment ``in=``.
    """
    time = run.time - run.time[0]
    end = float(max(time[-1], 1e-3))
    data = {
        "end": round(end, 3),
        "segments": [(a, b, str(one), colour) for a, b, one, colour in _segments(time, run.segment)],
        "clock": [(round(a, 3), round(b, 3)) for a, b in clock],
        "stops": [(round(at - float(run.time[0]), 3), text) for at, text in run.stops],
    }
    best = min((1, 2, 4, 8, 16, 32), key=lambda v: abs(np.log(end / v / 45.0)))
    options = "".join(
        f'<option value="{v}"{" selected" if v == best else ""}>{v:g} ×</option>'
        for v in (0.5, 1, 2, 4, 8, 16, 32)
    )
    return (
        "<div id='bar'><div class='row'>"
        "<button type='button' id='play' title='Play or pause (space)' aria-label='Play'>▶</button>"
        "<div class='line'><div class='lane' aria-hidden='true'></div>"
        f"<input type='range' id='time' min='0' max='{end:.3f}' step='any' value='0' aria-label='Time'></div>"
        f"<select id='speed' title='Speed' aria-label='Speed of the replay'>{options}</select></div>"
        f"<div class='say'><b>{html.escape(name)}</b><span><span class='time'></span>"
        f"{_shares(end, run, motion_time)}</span>"
        "<span><i></i><span class='segment'></span></span>"
        "<span class='stopped' role='status'></span></div></div>"
        f"{embedded('track', data)}"
    )


def embedded(name: str, data: Any) -> str:
    """Data that a script of the page reads by that id."""
    packed = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f"<script type='application/json' id='{name}'>{packed}</script>"


def _shares(end: float, run: Track, motion_time: float | None) -> str:
    """What the time ``end`` [s] of a replay consists of; the report's ``motion_time`` [s] is a part of it."""
    if motion_time is None or end - motion_time < 0.05:
        return ""
    rest = "ways from and to home"
    rest += " and changes of setup" if SETUP_SEGMENT in run.segment else ""
    travel = f"{_clock_time(run.travel)} {TRAVEL_TIME}, " if run.travel else ""
    left = end - motion_time - run.travel
    return f": {_clock_time(motion_time)} {MOTION_TIME}, {travel}{_clock_time(left)} {rest}"


def _clock_time(seconds: float) -> str:
    """A time as the bar shows it: minutes, and seconds to a tenth."""
    tenths = round(10.0 * seconds)
    return f"{tenths // 600}:{tenths % 600 / 10:04.1f}"


def replay_clock(run: Track, time: FloatArray, labels: Sequence[str]) -> Clock:
    """How the programs' clock, ``time`` (S,) [s] with the ``labels`` (S,) of what is done (keys of
    segments), leads to the replay's: what has the same label in both begins and ends together, and so does
    the whole.

    The replay shows the ways from and to home at a pace of its own, so the clocks differ by more than a
    shift.
    """
    shown = [(one, a, b) for a, b, one, _ in _segments(run.time - run.time[0], run.segment)]
    out: list[tuple[float, float]] = []
    for label, first, last in _runs(labels):
        found = next((i for i, one in enumerate(shown) if one[0].key == label), None)
        if found is not None:
            _, start, end = shown[found]
            shown = shown[found + 1 :]
            out += [(float(time[max(first - 1, 0)]), start), (float(time[last]), end)]
    if not out:
        return ()
    return ((float(time[0]), 0.0), *out, (float(time[-1]), float(run.time[-1] - run.time[0])))


def _runs(labels: Sequence[str]) -> list[tuple[str, int, int]]:
    """Runs of equal labels: label, first and last index."""
    edges = [i for i in range(1, len(labels)) if labels[i] != labels[i - 1]]
    return [
        (str(labels[a]), a, b - 1)
        for a, b in zip([0, *edges], [*edges, len(labels)], strict=True)
        if len(labels)
    ]


def _segments(time: np.ndarray, segments: tuple[Segment, ...]) -> list[tuple[float, float, Segment, str]]:
    """Runs of one segment: start, end, segment, colour; it belongs to the way to its keyframe."""
    out: list[tuple[float, float, Segment, str]] = []
    for i in range(1, len(segments)):
        a, b = round(float(time[i - 1]), 3), round(float(time[i]), 3)
        if out and out[-1][2] == segments[i]:
            out[-1] = (out[-1][0], b, *out[-1][2:])
        else:
            out.append((a, b, segments[i], _SEGMENT_COLOURS.get(segments[i].kind, _OTHER_COLOUR)))
    return out
