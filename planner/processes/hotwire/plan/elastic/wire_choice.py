"""Which wire and which sweep cut a panel: those that look best are fitted whole, one after the other, until
one does. Where none does, the refusal names what would, and only what was tried.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import Final

import numpy as np

from planner.geometry.arrays import Mesh
from planner.geometry.units import MM
from planner.issues import Issue, Severity, TandemError
from planner.problem import Setup
from planner.processes.hotwire.plan.elastic.check import Cut, Figures
from planner.processes.hotwire.plan.elastic.path import Route
from planner.processes.hotwire.plan.elastic.sweep import (
    BENT_TOO_SHARPLY,
    EDGE_ANGLES,
    SWEEP_ANGLES,
    Screen,
    Sweep,
    ranked,
)
from planner.processes.hotwire.plan.operation import ElasticWire
from planner.processes.hotwire.plan.wire import Wire
from planner.reading.materials import WireFile

_WHOLE: Final = 3
"""So many wires and sweeps are fitted whole before a refusal, and less to find each kind of help."""
_FITTED_WITHIN: Final = 1.3
"""Looks beyond so many tolerances are not fitted whole, but for the nearest one."""
LENGTH_FACTORS: Final = (1.04, 1.12, 1.2, 1.35, 1.55, 1.8, 2.2)
"""Lengths that are tried beyond those at hand, as multiples of the least."""
LONGEST_MM: Final = 2000.0
"""No wire longer than this [mm] is advised."""
THINNER_FACTORS: Final = (0.98, 0.8)
"""Diameters that are tried where a wire is bent too far, as multiples of the one that just is not."""
THICKER_FACTORS: Final = (1.25, 1.6)
"""Diameters that are tried where a wire is too weak, as multiples."""
_THIN_FACTOR: Final = 0.75
"""How much thinner a wire is tried where another length of it would only be bent too far."""
_SURE_SHARE: Final = 0.95
"""A remedy is looked for within this share of the tolerance first, to leave room."""
_MOST_LOOSENING: Final = 4.0
"""No tolerance is named beyond so many times the stated one."""


@dataclasses.dataclass(frozen=True)
class Attempt:
    """A wire and a sweep, both in ``op``, fitted whole: all that is cut and moved, with what was found.
    ``within`` [m]: the wanted share of each face, with weight and errors of the ends."""

    op: ElasticWire
    wire: Wire
    cuts: list[Cut]
    route: Route
    figures: Figures
    issues: list[Issue]
    within: float


Fit = Callable[[ElasticWire, Mapping[str, Mesh], Setup], Attempt]
"""Fits an operation with its wire and sweep to faces in a block; raises ``TandemError``."""


def choose(screen: Screen, fit: Fit, advise: bool = True) -> tuple[Attempt, list[Sweep]]:
    """The first wire and sweep that do, of those that the operation leaves open, with all that were looked
    at. Raises ``TandemError`` with what the nearest ones lack and, with ``advise``, what would help, which
    takes up to half a minute."""
    op, tol = screen.op, screen.op.shape_tol_mm * MM
    wires = op.wires(screen.setup.cell.wires)
    sweeps = SWEEP_ANGLES if op.degrees is None else (op.degrees,)
    if len(wires) * len(sweeps) == 1:  # nothing to choose
        tried = [Sweep(sweeps[0], 0.0, 0.0, 0.0, wires[0])]
    else:
        tried = ranked([screen.sweep(own, degrees) for own in wires for degrees in sweeps], tol)
    near = [s for s in tried if not s.why and s.score < _FITTED_WITHIN * tol] or [
        min(tried, key=lambda s: s.score)
    ]
    refused: list[tuple[Issue, ...]] = []
    for sweep in near[:_WHOLE]:
        made = _made(screen, fit, sweep, refused)
        if made is not None:
            return made, tried if len(tried) > 1 else []
    raise TandemError(_refusal(screen, fit, tried, refused, advise))


def sweep_notes(screen: Screen, made: Attempt, tried: list[Sweep]) -> list[Issue]:
    """The note on what was chosen, where the problem leaves the wire open."""
    if screen.op.wire is not None:
        return []
    count = len(screen.op.wires(screen.setup.cell.wires))
    what = (
        f"{screen.op.name}: of {count} wires at hand {made.op.chosen} is to be mounted, swept along "
        f"{made.op.way}: {made.op.share * 100:g} % of each face within {made.within * 1e3:.2f} mm with its "
        f"weight and errors of its ends; allowed: {made.op.shape_tol_mm:g} mm"
    )
    del tried
    hint = "state wire and sweep in the operation to have another one"
    return [Issue("wire.chosen", what, Severity.NOTE, field="wire", hint=hint)]


def _made(
    screen: Screen, fit: Fit, sweep: Sweep, refused: list[tuple[Issue, ...]] | None = None
) -> Attempt | None:
    if sweep.wire is None:
        return None
    try:
        return fit(screen.op.using(sweep.wire, sweep.degrees), screen.wanted, screen.setup)
    except TandemError as error:
        if refused is not None:
            refused.append(error.issues)
        return None


def _refusal(
    screen: Screen, fit: Fit, tried: list[Sweep], refused: list[tuple[Issue, ...]], advise: bool
) -> list[Issue]:
    """What the nearest wire and sweep lack, with what helps as the hint of the first."""
    issues = list(refused[0])
    helps = "; or ".join(_helps(screen, fit, tried, issues)) if advise else ""
    if len(tried) > 1:
        wires = len({s.wire for s in tried})
        count = f"{wires} wire{'s' if wires > 1 else ''} along {len({s.degrees for s in tried})} directions"
        first = issues[0]
        issues[0] = dataclasses.replace(first, message=f"{first.message} (the best of {count})")
    return [issue if not helps else dataclasses.replace(issue, hint=helps) for issue in issues]


def _helps(screen: Screen, fit: Fit, tried: list[Sweep], issues: list[Issue]) -> list[str]:
    """What was found to help: a wire or sweep, else a cut line, and a tolerance."""
    codes = {issue.code for issue in issues}
    best = min(tried, key=lambda s: s.score)
    if codes - _WIRE_CODES:
        return []
    helps = [next(itertools.chain(_wires(screen, fit, tried, issues), _splits(screen, fit, tried)), "")]
    helps += [_tolerance(screen, fit, best, issues)] if codes <= _TOLERANCE_CODES else []
    return [h for h in helps if h] or [
        "no other wire, sweep, cut line or tolerance that was tried does; make the panel smoother or smaller"
    ]


def _wires(screen: Screen, fit: Fit, tried: list[Sweep], issues: list[Issue]) -> Iterator[str]:
    """Another wire or sweep, the least change first."""
    op = screen.op
    known = {(s.wire, s.degrees) for s in tried}
    wires = list(dict.fromkeys(s.wire for s in tried if s.wire is not None))
    at_hand = map(WireFile.of, screen.setup.cell.wires)
    wires += [w for w in at_hand if w not in wires and (w.is_round or op.power_w is None)]
    looks = [screen.sweep(w, d) for w in wires for d in SWEEP_ANGLES if (w, d) not in known]
    made = _best(screen, fit, looks)
    if made is not None:
        which = "the same wire" if op.wire == made.op.chosen else f"{made.op.chosen}, which is at hand,"
        yield _said(made, f"{which} does, swept along {made.op.way} (sweep: {_key(made.op)})")
    best = min(tried, key=lambda s: s.score)
    base = best.wire or wires[0]
    sweeps = [
        degrees
        for degrees in dict.fromkeys((*EDGE_ANGLES, best.degrees))
        if screen.shape_alone(base, degrees)[0] < op.shape_tol_mm * MM
    ]
    short = [i.limit for i in issues if i.code == "wire.too_short" and i.limit]
    more = [base.model_copy(update={"length_mm": 5.0 * np.ceil(n / 5.0)}) for n in short if n <= LONGEST_MM]
    looks = [screen.sweep(w, best.degrees) for w in more]
    looks += [screen.sweep(w, d) for d in sweeps for w in _longer(screen, base, d)]
    span = f"{min(s.length for s in looks):g} to {max(s.length for s in looks):g} mm" if looks else ""
    made = _best(screen, fit, looks, base)
    if made is not None:
        length = made.op.chosen.length_mm
        what = f"a wire of {length:g} mm does, swept along {made.op.way} (length_mm: {length:g}, sweep: "
        yield _said(made, f"{what}{_key(made.op)}; tried were {span})")
    bent = [i.value / i.limit for i in issues if i.code == "wire.curvature" and i.value and i.limit]
    if not bent and any(s.why == BENT_TOO_SHARPLY and s.score < op.shape_tol_mm * MM for s in looks):
        bent = [_THIN_FACTOR]
    if (bent or "wire.weight" in {i.code for i in issues}) and base.diameter_mm is not None:
        just = base.diameter_mm * min(bent, default=1.0)
        sizes = [
            float(np.clip(np.floor(10.0 * just * f) / 10.0, 0.1, 10.0))
            for f in (THINNER_FACTORS if bent else THICKER_FACTORS)
        ]
        thick = [base.model_copy(update={"diameter_mm": d}) for d in dict.fromkeys(sizes)]
        looks = [screen.sweep(w, d) for d in sweeps for t in thick for w in _longer(screen, t, d, 2)]
        made = _best(screen, fit, looks, base)
        if made is not None:
            own = made.op.chosen
            what = f"a wire of {own.diameter_mm:g} mm and {own.length_mm:g} mm length does, swept along "
            what += f"{made.op.way} (diameter_mm: {own.diameter_mm:g}, length_mm: {own.length_mm:g}, sweep: "
            yield _said(made, f"{what}{_key(made.op)})")


def _splits(screen: Screen, fit: Fit, tried: list[Sweep]) -> Iterator[str]:
    """A cut line across the wire, of which both sides are cut as panels of their own, each in its own part
    of the block."""
    tol = screen.op.shape_tol_mm * MM
    nearest = min(tried, key=lambda s: s.score)
    base = nearest.wire
    if base is None or tol * _SPLIT_WITHIN < nearest.score < 1.0:
        return
    lines: list[tuple[float, str, float, list[Screen]]] = []
    for degrees in EDGE_ANGLES:
        axis = int(degrees == 0.0)  # the wire is along y where the sweep is along x
        low, high = screen.setup.stock.box[:, axis]
        for part in _SPLIT_SHARES:
            at = float(np.round(low + part * (high - low), 3))
            sides = [side for keep in (-1.0, 1.0) if (side := screen.side(axis, at, keep)) is not None]
            score = max((_quick(side, base, degrees) for side in sides), default=np.inf)
            if len(sides) == 2 and score < 2.0 * tol:
                lines.append((score, f"{'xy'[axis]} = {at / MM:g}", degrees, sides))
    for _, where, degrees, sides in sorted(lines, key=lambda line: line[0])[:3]:
        made = [_half(side, fit, base, degrees) for side in sides]
        a, b = (
            ""
            if m is None
            else f"{m.within / MM:.2f} mm with a wire of {_size(m.op.chosen)} swept along {m.op.way}"
            for m in made
        )
        if a and b:
            yield (
                f"split the panel at {where} mm of the block, and cut each side in its own part of it: "
                f"below within {a}, above within {b}"
            )


_SPLIT_SHARES: Final = (0.3, 0.4, 0.5, 0.6, 0.7)
"""Shares of the block's size at which it is tried to split a panel."""
_SPLIT_WITHIN: Final = 12.0
"""Panels that are off by so many tolerances are not tried to be split in two."""
_FIRST_LENGTHS: Final = 3
"""So many lengths are known when a side is looked at first, with the last of them."""


def _quick(side: Screen, base: WireFile, degrees: float) -> float:
    """How near [m] one wire comes to a side of a cut line; infinite where none can."""
    try:
        wires = _longer(side, base, degrees)[:_FIRST_LENGTHS]
        if not wires or side.shape_alone(base, degrees)[0] > side.op.shape_tol_mm * MM:
            return np.inf
        return side.sweep(wires[-1], degrees).score
    except TandemError:  # a side too sharp to be moved by half a slot, and the like
        return np.inf


def _size(wire: WireFile) -> str:
    return f"{wire.length_mm:g} mm" + ("" if wire.diameter_mm is None else f" ({wire.size})")


def _half(side: Screen, fit: Fit, base: WireFile, degrees: float) -> Attempt | None:
    """One side of a cut line with a wire at hand or of another length, thinner where it is bent too far."""
    tol = side.op.shape_tol_mm * MM
    thinner = (1.0, 0.7, 0.45, 0.25) if base.diameter_mm is not None else (1.0,)
    for factor in thinner:
        size = {} if factor == 1.0 else {"diameter_mm": round(factor * (base.diameter_mm or 0.0), 1)}
        known = [*side.op.wires(side.setup.cell.wires)] if factor == 1.0 else []
        most = 2.5 * (side.shape_alone(base, degrees)[1] / MM + 2.0 * side.op.margin_mm)
        wires = [w for w in known if w.length_mm < most] + _longer(
            side, base.model_copy(update=size | {"length_mm": 50.0}), degrees
        )
        looks = [side.sweep(w, degrees) for w in wires]
        good = [s for s in looks if not s.why and s.score < _SURE_SHARE * tol]
        for look in sorted(good, key=lambda s: s.score)[:1]:
            made = _made(side, fit, look)
            if made is not None:
                return made
        if not any(s.why == BENT_TOO_SHARPLY and s.score < tol for s in looks):
            break
    return None


def _tolerance(screen: Screen, fit: Fit, sweep: Sweep, issues: list[Issue]) -> str:
    off = max((issue.value for issue in issues if issue.value is not None), default=np.inf)
    for factor in (1.01, 1.25, 1.6):  # more may come on top where the first bound is kept
        tol = float(np.ceil(100.0 * factor * off) / 100.0)
        if sweep.wire is None or tol > _MOST_LOOSENING * screen.op.shape_tol_mm:
            return ""
        looser = screen.with_operation(screen.op.model_copy(update={"shape_tol_mm": tol}))
        made = _made(looser, fit, sweep)
        if made is not None:
            return f"allow more: shape_tol_mm: {tol:g} does with {sweep.wire} swept along {made.op.way}"
    return ""


_TOLERANCE_CODES: Final = {"wire.shape", "wire.weight", "wire.end_error"}
"""Codes that a larger tolerance mends."""


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
"""Codes that another wire may mend."""


def _longer(screen: Screen, base: WireFile, degrees: float, every: int = 1) -> list[WireFile]:
    """Wires of one section that are long enough for a sweep, that of the stated length first."""
    _, longest = screen.shape_alone(base, degrees)
    least = longest / MM + 2.0 * screen.op.margin_mm
    lengths = [base.length_mm, *(float(np.ceil(least * f / 10.0) * 10.0) for f in LENGTH_FACTORS[::every])]
    known = [n for n in dict.fromkeys(lengths) if max(50.0, least) <= n <= LONGEST_MM]
    return [base.model_copy(update={"length_mm": n}) for n in known]


def _best(screen: Screen, fit: Fit, looks: list[Sweep], base: WireFile | None = None) -> Attempt | None:
    """The nearest of the looks that does when it is fitted whole."""
    tol = screen.op.shape_tol_mm * MM
    good = [s for s in looks if not s.why and s.score < tol]

    def far(sweep: Sweep) -> tuple[float, ...]:
        change = 0.0 if base is None else abs(sweep.length - base.length_mm)
        thick = 0.0 if base is None or sweep.wire is None else _thickness_change(base, sweep.wire)
        return (float(sweep.score > _SURE_SHARE * tol), thick, change, sweep.score)

    for sweep in sorted(good, key=far)[:2]:
        made = _made(screen, fit, sweep)
        if made is not None:
            return made
    return None


def _thickness_change(a: WireFile, b: WireFile) -> float:
    return abs((a.diameter_mm or 0.0) - (b.diameter_mm or 0.0))


def _said(made: Attempt, what: str) -> str:
    return f"{what}: within {made.within * 1e3:.2f} mm with its weight and errors of its ends"


def _key(op: ElasticWire) -> str:
    return {0.0: "x", 90.0: "y"}.get(op.degrees or 0.0, f"{op.degrees:g}")
