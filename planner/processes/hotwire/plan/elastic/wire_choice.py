"""Choice of the wire and sweep for a panel.

The candidates that screen best are fitted to the whole faces, one after another, until one succeeds. If none
does, the refusal suggests changes of the wire, the panel or the tolerance. Each suggested change was tried
and succeeded.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import Final

import numpy as np

from planner.geometry.arrays import Mesh
from planner.geometry.units import MM
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError
from planner.problem import Setup
from planner.processes.hotwire.plan.elastic.check import ElasticCut, TargetFigures
from planner.processes.hotwire.plan.elastic.path import WireRoute
from planner.processes.hotwire.plan.elastic.sweep_screening import (
    BENT_TOO_SHARPLY,
    EDGE_ANGLES,
    SWEEP_ANGLES,
    SweepCandidate,
    SweepScreen,
    rank_candidates,
)
from planner.processes.hotwire.plan.operation import ElasticWire
from planner.processes.hotwire.plan.wire import HeatedWire
from planner.reading.materials import WireFile

_MAX_FULL_FITS: Final = 3
"""Maximum number of candidates fitted to whole faces before a refusal. The search for hints fits more."""
_MAX_FIT_FACTOR: Final = 1.3
"""Candidates that miss by more than this multiple of the tolerance are not fitted to whole faces.

If all of them do, the one that misses least is fitted.
"""
LENGTH_FACTORS: Final = (1.04, 1.12, 1.2, 1.35, 1.55, 1.8, 2.2)
"""Wire lengths that are tried besides those available, as multiples of the shortest possible."""
MAX_LENGTH_MM: Final = 2000.0
"""Maximum length of a wire that a hint suggests [mm]."""
THINNER_FACTORS: Final = (0.98, 0.8)
"""Diameters that are tried if a wire is bent too far, as multiples of the largest diameter that is not."""
THICKER_FACTORS: Final = (1.25, 1.6)
"""Diameters that are tried if a wire sags too far, as multiples of the diameter of the best one."""
_THINNER_FACTOR: Final = 0.75
"""Factor on the diameter that is tried if another length would only be bent too far."""
_MARGIN_FRACTION: Final = 0.95
"""Remedies within this fraction of the tolerance are preferred, to leave a margin."""
_MAX_TOLERANCE_FACTOR: Final = 4.0
"""Maximum multiple of the stated tolerance that a hint suggests."""


@dataclasses.dataclass(frozen=True)
class WireAttempt:
    """A wire and sweep fitted to whole faces.

    Attributes:
        op: Operation with this wire and sweep.
        wire: The wire.
        cuts: The faces.
        route: Wires of the job.
        figures: Values of the targets, such as stability and sag.
        issues: Warnings and notes. An attempt with errors raises instead.
        within: Distance [m] within which the required fraction of each face is cut, including weight and
            errors of the ends.
    """

    op: ElasticWire
    wire: HeatedWire
    cuts: list[ElasticCut]
    route: WireRoute
    figures: TargetFigures
    issues: list[Issue]
    within: float


FitCandidate = Callable[[ElasticWire, Mapping[str, Mesh], Setup], WireAttempt]
"""Fits an operation with its wire and sweep to faces in a block. Raises ``TandemError``."""


def choose_wire(
    screen: SweepScreen, fit: FitCandidate, advise: bool = True
) -> tuple[WireAttempt, list[SweepCandidate]]:
    """Return the first wire and sweep that succeed, and the candidates that were screened.

    At most `_MAX_FULL_FITS` candidates are fitted to whole faces, in order of preference: those that screen
    within `_MAX_FIT_FACTOR` times the tolerance, or else the one with the least score alone.

    Args:
        screen: Screen of the candidates.
        fit: Fits a candidate to whole faces.
        advise: Whether a refusal includes hints on what would help. This takes up to half a minute.

    Returns:
        The attempt, and all screened candidates in order of preference, or none if there was no choice.

    Raises:
        TandemError: If no candidate succeeds, with the issues of the first one that was fitted.
    """
    op, tol = screen.op, screen.op.shape_tol_mm * MM
    wires = op.candidate_wires(screen.setup.cell.wires)
    sweeps = SWEEP_ANGLES if op.sweep_degrees is None else (op.sweep_degrees,)
    if len(wires) * len(sweeps) == 1:  # nothing to choose
        tried = [SweepCandidate(sweeps[0], 0.0, 0.0, 0.0, wires[0])]
    else:
        tried = rank_candidates([screen.screen(wire, degrees) for wire in wires for degrees in sweeps], tol)
    promising = [s for s in tried if not s.reason and s.score < _MAX_FIT_FACTOR * tol] or [
        min(tried, key=lambda s: s.score)
    ]
    refused: list[tuple[Issue, ...]] = []
    for sweep in promising[:_MAX_FULL_FITS]:
        attempt = _try_candidate(screen, fit, sweep, refused)
        if attempt is not None:
            return attempt, tried if len(tried) > 1 else []
    raise TandemError(_refusal_issues(screen, fit, tried, refused, advise))


def sweep_notes(screen: SweepScreen, attempt: WireAttempt, tried: list[SweepCandidate]) -> list[Issue]:
    """Return a note that names the chosen wire and sweep, or nothing if the problem states the wire."""
    if screen.op.wire is not None:
        return []
    count = len(screen.op.candidate_wires(screen.setup.cell.wires))
    message = format_message(
        "wire.chosen",
        operation=screen.op.name,
        wire_count=count,
        wire=attempt.op.chosen_wire,
        sweep=attempt.op.sweep_label,
        required_percent=attempt.op.share * 100,
        deviation_mm=attempt.within * 1e3,
        tolerance_mm=attempt.op.shape_tol_mm,
    )
    del tried
    hint = "to use another one, state wire and sweep in the operation"
    return [Issue("wire.chosen", message, Severity.NOTE, field="wire", hint=hint)]


def _try_candidate(
    screen: SweepScreen,
    fit: FitCandidate,
    sweep: SweepCandidate,
    refused: list[tuple[Issue, ...]] | None = None,
) -> WireAttempt | None:
    """Fit a candidate to whole faces. If it fails, append its issues to ``refused`` and return None."""
    if sweep.wire is None:
        return None
    try:
        return fit(screen.op.with_wire(sweep.wire, sweep.degrees), screen.nominal_faces, screen.setup)
    except TandemError as error:
        if refused is not None:
            refused.append(error.issues)
        return None


def _refusal_issues(
    screen: SweepScreen,
    fit: FitCandidate,
    tried: list[SweepCandidate],
    refused: list[tuple[Issue, ...]],
    advise: bool,
) -> list[Issue]:
    """Return the issues of the first candidate that was fitted, all with one hint on what would help."""
    issues = list(refused[0])
    hint = "; or ".join(_hints(screen, fit, tried, issues)) if advise else ""
    if len(tried) > 1:
        wires = len({s.wire for s in tried})
        count = f"{wires} wire{'s' if wires > 1 else ''} along {len({s.degrees for s in tried})} directions"
        first = issues[0]
        issues[0] = dataclasses.replace(first, message=f"{first.message} (the best of {count})")
    return [issue if not hint else dataclasses.replace(issue, hint=hint) for issue in issues]


def _hints(
    screen: SweepScreen, fit: FitCandidate, tried: list[SweepCandidate], issues: list[Issue]
) -> list[str]:
    """Return changes of the problem that were tried and help, as text.

    The first hint names another wire or sweep, or else a cut line through the panel. A second one names a
    larger tolerance if this can resolve all issues. If nothing helps, one text says so. The list is empty if
    an issue has another cause than the wire.
    """
    codes = {issue.code for issue in issues}
    best = min(tried, key=lambda s: s.score)
    if codes - _WIRE_CODES:
        return []
    hints = [
        next(itertools.chain(_wire_hints(screen, fit, tried, issues), _split_hints(screen, fit, tried)), "")
    ]
    if codes <= _TOLERANCE_CODES:
        hints.append(_tolerance_hint(screen, fit, best, issues))
    return [h for h in hints if h] or [
        "no wire, sweep, cut line or tolerance that was tried works; make the panel smoother or smaller"
    ]


def _wire_hints(
    screen: SweepScreen, fit: FitCandidate, tried: list[SweepCandidate], issues: list[Issue]
) -> Iterator[str]:
    """Yield hints on other wires and sweeps that were tried and work, the smallest change first.

    The order is: available wires along all directions, other lengths of the best wire, other diameters of it.
    Fits cost time. The caller therefore takes the first hint only, and later changes are not tried then.
    """
    op = screen.op
    # available wires along all directions
    screened = {(s.wire, s.degrees) for s in tried}
    wires = list(dict.fromkeys(s.wire for s in tried if s.wire is not None))
    available = map(WireFile.from_wire, screen.setup.cell.wires)
    wires += [w for w in available if w not in wires and (w.is_round or op.power_w is None)]
    candidates = [screen.screen(w, d) for w in wires for d in SWEEP_ANGLES if (w, d) not in screened]
    attempt = _best_attempt(screen, fit, candidates)
    if attempt is not None:
        subject = (
            "the same wire"
            if op.wire == attempt.op.chosen_wire
            else f"{attempt.op.chosen_wire}, which is available,"
        )
        yield _success_text(
            attempt,
            f"{subject} works, swept along {attempt.op.sweep_label} (sweep: {_sweep_value(attempt.op)})",
        )
    # the best wire in other lengths, along the edges of the block
    best = min(tried, key=lambda s: s.score)
    base = best.wire or wires[0]
    sweeps = [
        degrees
        for degrees in dict.fromkeys((*EDGE_ANGLES, best.degrees))
        if screen.shape_only(base, degrees)[0] < op.shape_tol_mm * MM
    ]
    required_lengths = [i.limit for i in issues if i.code == "wire.too_short" and i.limit]
    longer_wires = [
        base.model_copy(update={"length_mm": 5.0 * np.ceil(n / 5.0)})
        for n in required_lengths
        if n <= MAX_LENGTH_MM
    ]
    candidates = [screen.screen(w, best.degrees) for w in longer_wires]
    candidates += [screen.screen(w, d) for d in sweeps for w in _long_enough_wires(screen, base, d)]
    span = (
        f"{min(s.wire_length_mm for s in candidates):g} to {max(s.wire_length_mm for s in candidates):g} mm"
        if candidates
        else ""
    )
    attempt = _best_attempt(screen, fit, candidates, base)
    if attempt is not None:
        length = attempt.op.chosen_wire.length_mm
        text = (
            f"a wire of {length:g} mm works, swept along {attempt.op.sweep_label} (length_mm: {length:g}, "
            "sweep: "
        )
        yield _success_text(attempt, f"{text}{_sweep_value(attempt.op)}; tried were {span})")
    # the best wire with other diameters: thinner if it is bent too sharply, thicker if it sags too far
    curvature_ratios = [
        i.value / i.limit for i in issues if i.code == "wire.curvature" and i.value and i.limit
    ]
    if not curvature_ratios and any(
        s.reason == BENT_TOO_SHARPLY and s.score < op.shape_tol_mm * MM for s in candidates
    ):
        curvature_ratios = [_THINNER_FACTOR]
    if (curvature_ratios or "wire.weight" in {i.code for i in issues}) and base.diameter_mm is not None:
        max_diameter = base.diameter_mm * min(curvature_ratios, default=1.0)
        sizes = [
            float(np.clip(np.floor(10.0 * max_diameter * f) / 10.0, 0.1, 10.0))
            for f in (THINNER_FACTORS if curvature_ratios else THICKER_FACTORS)
        ]
        resized = [base.model_copy(update={"diameter_mm": d}) for d in dict.fromkeys(sizes)]
        candidates = [
            screen.screen(w, d) for d in sweeps for t in resized for w in _long_enough_wires(screen, t, d, 2)
        ]
        attempt = _best_attempt(screen, fit, candidates, base)
        if attempt is not None:
            chosen = attempt.op.chosen_wire
            text = (
                f"a wire of {chosen.diameter_mm:g} mm and {chosen.length_mm:g} mm length works, swept along "
            )
            text += (
                f"{attempt.op.sweep_label} (diameter_mm: {chosen.diameter_mm:g}, length_mm: "
                f"{chosen.length_mm:g}, sweep: "
            )
            yield _success_text(attempt, f"{text}{_sweep_value(attempt.op)})")


def _split_hints(screen: SweepScreen, fit: FitCandidate, tried: list[SweepCandidate]) -> Iterator[str]:
    """Yield hints on cut lines across the wire whose two sides can be cut as separate panels.

    Each side is cut in its own part of the block. The three lines that screen best are tried. No line is
    tried if the best candidate misses by more than `_MAX_SPLIT_FACTOR` times the tolerance.
    """
    tol = screen.op.shape_tol_mm * MM
    best = min(tried, key=lambda s: s.score)
    base = best.wire
    # a score of 1 m and more stands for a wire that cannot be held, which a split may still remedy
    if base is None or tol * _MAX_SPLIT_FACTOR < best.score < 1.0:
        return
    lines: list[tuple[float, str, float, list[SweepScreen]]] = []
    for degrees in EDGE_ANGLES:
        axis = int(degrees == 0.0)  # 1 (y) for a sweep along x, because the wire is then along y
        low, high = screen.setup.stock.box[:, axis]
        for fraction in _SPLIT_FRACTIONS:
            position = float(np.round(low + fraction * (high - low), 3))
            sides = [
                side for keep in (-1.0, 1.0) if (side := screen.split_side(axis, position, keep)) is not None
            ]
            score = max((_screen_side(side, base, degrees) for side in sides), default=np.inf)
            if len(sides) == 2 and score < 2.0 * tol:
                lines.append((score, f"{'xy'[axis]} = {position / MM:g}", degrees, sides))
    for _, line_label, degrees, sides in sorted(lines, key=lambda line: line[0])[:3]:
        attempts = [_attempt_side(side, fit, base, degrees) for side in sides]
        below, above = (
            ""
            if attempt is None
            else f"{attempt.within / MM:.2f} mm with a wire of {_size_text(attempt.op.chosen_wire)} swept "
            f"along {attempt.op.sweep_label}"
            for attempt in attempts
        )
        if below and above:
            yield (
                f"split the panel at {line_label} mm of the block, and cut each side in its own part of it: "
                f"below within {below}, above within {above}"
            )


_SPLIT_FRACTIONS: Final = (0.3, 0.4, 0.5, 0.6, 0.7)
"""Positions of tried cut lines as fractions of the block's size."""
_MAX_SPLIT_FACTOR: Final = 12.0
"""Panels whose best candidate misses by more than this multiple of the tolerance are not split."""
_SCREENED_LENGTHS: Final = 3
"""Number of wire lengths among which the first screening of a side takes the longest."""


def _screen_side(side: SweepScreen, base: WireFile, degrees: float) -> float:
    """Return the score [m] of a sufficiently long wire on a side of a cut line, infinite if none fits."""
    try:
        wires = _long_enough_wires(side, base, degrees)[:_SCREENED_LENGTHS]
        if not wires or side.shape_only(base, degrees)[0] > side.op.shape_tol_mm * MM:
            return np.inf
        return side.screen(wires[-1], degrees).score
    except TandemError:  # for example a side too sharp to be offset by half a slot
        return np.inf


def _size_text(wire: WireFile) -> str:
    return f"{wire.length_mm:g} mm" + ("" if wire.diameter_mm is None else f" ({wire.size})")


def _attempt_side(side: SweepScreen, fit: FitCandidate, base: WireFile, degrees: float) -> WireAttempt | None:
    """Return an attempt that succeeds on one side of a cut line, or None.

    Available wires and other lengths of ``base`` are tried, then thinner ones if the wire is bent too
    sharply.
    """
    tol = side.op.shape_tol_mm * MM
    thinner = (1.0, 0.7, 0.45, 0.25) if base.diameter_mm is not None else (1.0,)  # factors on the diameter
    for factor in thinner:
        size = {} if factor == 1.0 else {"diameter_mm": round(factor * (base.diameter_mm or 0.0), 1)}
        available = [*side.op.candidate_wires(side.setup.cell.wires)] if factor == 1.0 else []
        max_length = 2.5 * (side.shape_only(base, degrees)[1] / MM + 2.0 * side.op.margin_mm)
        wires = [w for w in available if w.length_mm < max_length] + _long_enough_wires(
            side, base.model_copy(update=size | {"length_mm": 50.0}), degrees
        )
        candidates = [side.screen(w, degrees) for w in wires]
        valid = [s for s in candidates if not s.reason and s.score < _MARGIN_FRACTION * tol]
        for candidate in sorted(valid, key=lambda s: s.score)[:1]:
            attempt = _try_candidate(side, fit, candidate)
            if attempt is not None:
                return attempt
        if not any(s.reason == BENT_TOO_SHARPLY and s.score < tol for s in candidates):
            break
    return None


def _tolerance_hint(
    screen: SweepScreen, fit: FitCandidate, sweep: SweepCandidate, issues: list[Issue]
) -> str:
    """Return a hint with a larger tolerance at which a candidate succeeds, or an empty text.

    Multiples of the largest deviation that an issue states are tried, up to `_MAX_TOLERANCE_FACTOR` times the
    tolerance.
    """
    largest_deviation = max((issue.value for issue in issues if issue.value is not None), default=np.inf)
    for factor in (1.01, 1.25, 1.6):  # meeting the first bound may reveal further ones
        tol = float(np.ceil(100.0 * factor * largest_deviation) / 100.0)
        if sweep.wire is None or tol > _MAX_TOLERANCE_FACTOR * screen.op.shape_tol_mm:
            return ""
        loosened = screen.with_operation(screen.op.model_copy(update={"shape_tol_mm": tol}))
        attempt = _try_candidate(loosened, fit, sweep)
        if attempt is not None:
            return (
                f"allow more: shape_tol_mm: {tol:g} works with {sweep.wire} swept along "
                f"{attempt.op.sweep_label}"
            )
    return ""


_TOLERANCE_CODES: Final = {"wire.shape", "wire.weight", "wire.end_error"}
"""Issue codes that a larger tolerance can resolve."""


_WIRE_CODES: Final = {
    "wire.shape",
    "wire.too_short",
    "wire.curvature",
    "wire.unstable",
    "wire.weight",
    "wire.end_error",
    "wire.touches",
    "wire.between_targets",
}
"""Issue codes that another wire can resolve."""


def _long_enough_wires(
    screen: SweepScreen, base: WireFile, degrees: float, stride: int = 1
) -> list[WireFile]:
    """Return wires with the cross-section of ``base`` that are long enough for a sweep, its length first.

    Every ``stride``-th one of `LENGTH_FACTORS` is tried.
    """
    _, longest = screen.shape_only(base, degrees)
    min_length = longest / MM + 2.0 * screen.op.margin_mm
    lengths = [
        base.length_mm,
        *(float(np.ceil(min_length * f / 10.0) * 10.0) for f in LENGTH_FACTORS[::stride]),
    ]
    valid_lengths = [
        length for length in dict.fromkeys(lengths) if max(50.0, min_length) <= length <= MAX_LENGTH_MM
    ]
    return [base.model_copy(update={"length_mm": length}) for length in valid_lengths]


def _best_attempt(
    screen: SweepScreen, fit: FitCandidate, candidates: list[SweepCandidate], base: WireFile | None = None
) -> WireAttempt | None:
    """Return the attempt of the best candidate that succeeds on whole faces, or None.

    The two best candidates are fitted at most. Those with a margin to the tolerance (`_MARGIN_FRACTION`) are
    better than others, then those with the diameter and the length closest to ``base``, then those with the
    least score.
    """
    tol = screen.op.shape_tol_mm * MM
    valid = [s for s in candidates if not s.reason and s.score < tol]

    def sort_key(sweep: SweepCandidate) -> tuple[float, ...]:
        change = 0.0 if base is None else abs(sweep.wire_length_mm - base.length_mm)
        thickness_change = 0.0 if base is None or sweep.wire is None else _thickness_change(base, sweep.wire)
        return (float(sweep.score > _MARGIN_FRACTION * tol), thickness_change, change, sweep.score)

    for sweep in sorted(valid, key=sort_key)[:2]:
        attempt = _try_candidate(screen, fit, sweep)
        if attempt is not None:
            return attempt
    return None


def _thickness_change(a: WireFile, b: WireFile) -> float:
    return abs((a.diameter_mm or 0.0) - (b.diameter_mm or 0.0))


def _success_text(attempt: WireAttempt, text: str) -> str:
    return f"{text}: within {attempt.within * 1e3:.2f} mm, including weight and end errors"


def _sweep_value(op: ElasticWire) -> str:
    return {0.0: "x", 90.0: "y"}.get(op.sweep_degrees or 0.0, f"{op.sweep_degrees:g}")
