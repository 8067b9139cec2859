"""Remedies followed: the number that a refusal advises is applied to the problem, which is planned again.

Issues have no field for a remedy: the number is in ``value``, ``limit``, or the message. The table here says
for each code where it is and to which field it applies, as a person would read it. A code that is not in it,
or a message without its number, counts as one without a number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import yaml

from bench.corpus.job import PROBLEM, Data, Job, text
from bench.corpus.run import FALSE, LIMIT, VERIFIED, Result, single

NUMBER: Final = r"(-?\d+(?:\.\d+)?)"
Follow = Callable[[Data, Data, Data, str], str | None]
"""Function of issue, problem, cell and the issue's text that changes problem or cell.

Returns what was done, or None if the issue names no number.
"""


def _number(pattern: str, text: str) -> float | None:
    match = re.search(pattern.replace("#", NUMBER), text)
    return None if match is None else float(match.group(1))


def _tools(cell: Data, kind: str) -> list[Data]:
    return [arm["tool"] for arm in cell["arms"] if arm["tool"]["kind"] == kind]


def _up(value: float, step: float = 1.0) -> float:
    return math.ceil(value / step - 1e-9) * step


def _down(value: float, step: float = 0.01) -> float:
    return round(math.floor(value / step + 1e-9) * step, 6)


def _block(issue: Data, problem: Data, cell: Data, advice: str) -> str | None:
    size = re.search(r"size_mm: \[([^]]*)\]", advice)
    if "sheet" in problem:
        return _sheet(problem, size, advice) or _opening(problem, 2.0 * float(issue["value"]))
    if size is not None:
        problem["stock"]["size_mm"] = [float(value) for value in size[1].split(",")]
        then = _wire(issue, problem, cell, advice) if "wire" in problem["operations"][0] else None
        return ", ".join(filter(None, (f"block of {problem['stock']['size_mm']} mm", then)))
    short = re.findall(rf"{NUMBER} mm in ([xyz])", advice)
    for value, axis in short:
        k = "xyz".index(axis)
        size = problem["stock"]["size_mm"]
        size[k] = round(size[k] + float(value) + 0.1, 1)
    return f"block of {problem['stock']['size_mm']} mm" if short else None


def _sheet(problem: Data, size: re.Match[str] | None, advice: str) -> str | None:
    """A sheet and opening as they are named."""
    opening = re.search(rf"opening_mm: (?:{NUMBER}|\[([^]]*)\])", advice)
    if size is None or opening is None:
        return None
    problem["sheet"]["size_mm"] = [float(value) for value in size[1].split(",")]
    wide = float(opening[1]) if opening[1] else [float(value) for value in opening[2].split(",")]
    problem["sheet"]["opening_mm"] = wide
    return f"opening of {wide} mm"


def _opening(problem: Data, more: float) -> str:
    sheet = problem["sheet"]
    old = sheet["opening_mm"]
    more = _up(more)
    sheet["opening_mm"] = [v + more for v in old] if isinstance(old, list) else old + more
    sheet["size_mm"] = [v + more for v in sheet["size_mm"]]
    return f"opening of {sheet['opening_mm']} mm"


def _clamp(issue: Data, problem: Data, cell: Data, advice: str) -> str | None:
    wider = _number("opening # mm wider", advice)
    if wider is None:
        return None
    clear = (
        problem.get("settings", {}).get("clearance_mm", 10.0) if "twice settings.clearance" in advice else 0.0
    )
    return _opening(problem, wider + 2.0 * clear)


def _tool(kind: str, key: str, pattern: str, factor: float = 1.0, down: bool = False) -> Follow:
    """A figure of the tool from the words."""

    def follow(issue: Data, problem: Data, cell: Data, advice: str) -> str | None:
        value = _number(pattern, advice)
        tools = _tools(cell, kind)
        if value is None or not tools:
            return None
        for tool in tools:
            tool[key] = _down(factor * value) if down else _up(factor * value)
        return f"{key} of {tools[0][key]:g}"

    return follow


def _operation(key: str, pattern: str, down: bool = False, inner: str | None = None) -> Follow:
    """A figure of the operation, or of a mapping in it, from the words."""

    def follow(issue: Data, problem: Data, cell: Data, advice: str) -> str | None:
        value = _number(pattern, advice)
        if value is None:
            return None
        own = problem["operations"][0] if inner is None else problem["operations"][0][inner]
        own[key] = _down(value) if down else value
        return f"{key} of {own[key]:g}"

    return follow


def _smaller(issue: Data, problem: Data, cell: Data, advice: str) -> str | None:
    """A gripper that no longer extends beyond the block's bottom."""
    out = _number("extends # mm beyond", advice)
    plates = _tools(cell, "gripper_plate")
    if out is None or not plates:
        return None
    for plate in plates:
        for key in ("width_mm", "depth_mm"):
            plate[key] = max(20.0, _down(plate[key] - 2.0 * out, 1.0))
    return f"gripper of {plates[0]['width_mm']:g} x {plates[0]['depth_mm']:g} mm"


def _flute(issue: Data, problem: Data, cell: Data, advice: str) -> str | None:
    for tool in _tools(cell, "mill"):
        tool["flute_mm"] = max(tool["flute_mm"], _up(float(issue["value"])))
        tool["overhang_mm"] = max(tool["overhang_mm"], tool["flute_mm"])
    return f"flute of {float(issue['value']):.1f}"


def _heat(issue: Data, problem: Data, cell: Data, message: str) -> str | None:
    """Use another power or feed, if the issue names one."""
    own = problem["operations"][0]
    advice = str(issue.get("hint") or message.rpartition(";")[2])
    if "no power or feed" in advice:
        return None
    power = _number("# W", advice)
    if power is not None:
        own["power_w"] = power
        return f"{power:g} W"
    feed = _number("# mm/s", advice)
    if feed is None:
        return None
    own["feed_mm_s"] = feed
    own["feed_min_mm_s"] = min(own.get("feed_min_mm_s", 3.0), feed)
    return f"{feed:g} mm/s"


def _move_stock(issue: Data, problem: Data, cell: Data, advice: str) -> str | None:
    """Move the stock by the advised vector."""
    place = problem.get("stock", problem.get("sheet", {})).get("place")
    match = re.search(rf"move the (?:stock|block|sheet) by \(?{NUMBER}, {NUMBER}, {NUMBER}\)? mm", advice)
    if match is None or not isinstance(place, dict):
        return None
    place["xyz_mm"] = [a + float(b) for a, b in zip(place["xyz_mm"], match.groups(), strict=True)]
    return f"stock at {place['xyz_mm']}"


def _wire(issue: Data, problem: Data, cell: Data, advice: str) -> str | None:
    """Length, diameter and sweep of the wire that does, or else the tolerance that it keeps."""
    own, done = problem["operations"][0], []
    for key in ("diameter_mm", "length_mm"):
        value = _number(f"{key}: #", advice)
        if value is not None:
            own["wire"][key] = value
            done.append(f"{key} of {value:g}")
    sweep = re.search(r"sweep: (x|y|-?[0-9.]*[0-9])", advice)
    if sweep is not None:
        own["sweep"] = sweep[1] if sweep[1] in "xy" else float(sweep[1])
        done.append(f"sweep {sweep[1]}")
    looser = _number("shape_tol_mm: #", advice)
    if not done and looser is not None:
        own["shape_tol_mm"] = looser
        done.append(f"shape_tol_mm of {looser:g}")
    return ", ".join(done) or None


def _plate(issue: Data, problem: Data, cell: Data, advice: str) -> str | None:
    """Use the advised width and depth of the plate; Tandem chooses its position."""
    width, depth = _number("has width_mm: #", advice), _number("depth_mm: #", advice)
    plates = _tools(cell, "gripper_plate")
    if width is None or depth is None or not plates:
        return _smaller(issue, problem, cell, advice)
    for plate in plates:
        plate.update(width_mm=width, depth_mm=depth)
    problem["stock"].pop("grip", None)
    return f"gripper of {width:g} x {depth:g} mm"


FITS: Final = "largest radius that fits(?: there)? is # mm"
REMEDIES: Final[dict[str, Follow]] = {
    "part.stock_too_small": _block,
    "forming.clamp": _clamp,
    "bow.span": _tool("bow", "span_mm", "need a wire of # mm"),
    "bow.throat": _tool("bow", "throat_mm", "throat_mm: #"),
    "forming.tool_radius": _tool("ball_tool", "radius_mm", FITS, down=True),
    "forming.support_radius": _tool("ball_tool", "radius_mm", FITS, down=True),
    "milling.tool_radius": _tool("mill", "diameter_mm", FITS, factor=2.0, down=True),
    "milling.flute": _flute,
    "milling.holder": _flute,
    "stock.footprint": _plate,
    "stock.grip_force": _tool("gripper_plate", "holding_n", "needs # N"),
    "wire.too_short": _wire,
    "wire.curvature": _wire,
    "wire.shape": _wire,
    "wire.weight": _wire,
    "wire.end_error": _wire,
    "wire.unstable": _wire,
    "wire.temperature": _operation("temperature_c", "(?:up to|at most|to) # C", inner="wire"),
    "forming.shift": _operation("shift_deg", "(?:at most|allowed is 0 to) #", down=True),
    "kerf.too_hot": _heat,
    "kerf.too_cold": _heat,
    "motion.no_reach": _move_stock,
    "motion.collision": _move_stock,
}


def words(issue: Data) -> str:
    """Message and hint of an issue."""
    return f"{issue['message']}; {issue.get('hint') or ''}"


def follow_remedies(job: Job, issues: Sequence[Data]) -> tuple[Job, str] | None:
    """Apply the first remedy of each code among ``issues`` to a job.

    Returns the job and what was done, or None if no issue names a number.
    """
    problem: Any = yaml.safe_load(job.files[PROBLEM])
    cell: Any = yaml.safe_load(job.files["cell.yaml"])
    done: dict[str, str] = {}
    for issue in issues:
        if issue["severity"] == "error" and issue["code"] in REMEDIES and issue["code"] not in done:
            what = REMEDIES[issue["code"]](issue, problem, cell, words(issue))
            if what is not None:
                done[issue["code"]] = what
    if not done:
        return None
    files = {**job.files, PROBLEM: text(problem), "cell.yaml": text(cell)}
    what = "; ".join(done.values())
    return Job(f"{job.name}_followed", job.family, job.seed, files, frozenset(), what), what


def follow(result: Result, folder: Path, limit: int = LIMIT) -> tuple[str, Result] | None:
    """Apply the advice of a refusal and plan again; None if it names no number."""
    changed = follow_remedies(result.job, result.plan["issues"])
    if changed is None:
        return None
    job, what = changed
    return what, single(job, folder, limit)


def markdown(rows: Sequence[tuple[Result, tuple[str, Result] | None]]) -> str:
    """The share of remedies with a number that led to a proven program, and each of them."""
    named = [(result, *pair) for result, pair in rows if pair is not None]
    good = sum(after.verdict == VERIFIED for _, _, after in named)
    fraction = f"{100.0 * good / len(named):.0f} %" if named else "-"
    out = [
        f"- of {len(rows)} refused jobs {len(named)} name a number; followed, {good} verify ({fraction})",
        "",
        "| job | refused by | remedy | then |",
        "| --- | --- | --- | --- |",
    ]
    for result, what, after in named:
        verdict = "refused again" if after.verdict == FALSE else after.verdict
        then = " ".join([verdict, *after.codes])
        out.append(f"| {result.job.name} | {' '.join(result.codes)} | {what} | {then} |")
    return "\n".join(out) + "\n"
