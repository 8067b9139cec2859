"""Charts of a motion: feed, clearance, margins, joint angles and speeds against their limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.problem import Settings
from planner.report import markup
from planner.report.charts import Level, Line, chart
from planner.report.inputs import ArmMotion, Clearance, Gap, Motion, WireMotion
from planner.report.markup import Raw
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]


def feed(motion: Motion) -> Raw:
    """Speed of the fastest guarded point against the window that the process asks for [mm/s]."""
    f = motion.feed
    cut = np.isfinite(f.lower) & (f.lower > 0.0)
    lines = [
        Line("speed", f.time, f.speed / MM, 0),
        Line("highest allowed", f.time, np.where(np.isfinite(f.upper), f.upper / MM, np.nan), 1, True),
        Line("lowest allowed", f.time, np.where(cut, f.lower / MM, np.nan), 3, True),
    ]
    fastest = float(np.nanmax(f.speed, initial=1e-3)) / MM
    work = np.isfinite(f.speed) & cut
    top = min(1.1 * fastest, 2.2 * float(np.max(f.upper[work])) / MM) if work.any() else 1.1 * fastest
    top = max(top, 1.2 * float(np.max(f.upper[work])) / MM) if work.any() else top
    body = chart(lines, x_label="s", y_label="mm/s", bands=motion.bands, y_range=(0.0, top))
    note = f"scaled to the work; moves outside it reach {markup.number(fastest, 3)} mm/s"
    return markup.figure(
        "Speed of the fastest guarded point", body, note if fastest > top else "tinted strongest: work"
    )


def clearance(data: Clearance, motion: Motion, settings: Settings) -> Raw:
    """Least distance over time [mm] with the asked one, and the pairs that come closest."""
    lines = [Line("arms, tools, block, obstacles", data.time, data.distance / MM, 2)]
    for wire in motion.wires:
        if wire.clearance is not None:
            away = np.where(np.asarray(wire.clearance) > 0.0, wire.clearance, np.nan) / MM
            lines.append(Line("wire", wire.time, away, 1))
    top = max([float(np.nanmax(line.y)) for line in lines if np.isfinite(line.y).any()] or [100.0])
    body = chart(
        lines,
        x_label="s",
        y_label="mm",
        bands=motion.bands,
        levels=[Level(settings.clearance / MM, "asked for")],
        y_range=(0.0, min(top * 1.1, 150.0) + 1.0),
    )
    worst = int(np.nanargmin(data.distance))
    at = f"{markup.fixed(data.distance[worst] / MM, 1)} mm at {markup.fixed(data.time[worst], 1)} s"
    note = f"least: {at}" + (f", {data.pair[worst]}" if data.pair[worst] else "")
    return markup.figure("Clearance of everything to everything", body, note)


def gap(data: Gap, motion: Motion) -> Raw:
    """What two tools leave between them over time [mm], within what is allowed."""
    lines = [
        Line("gap", data.time, data.got / MM, 0),
        Line("most", data.time, data.high / MM, 1, True),
        Line("least", data.time, data.low / MM, 3, True),
    ]
    room = np.minimum(data.got - data.low, data.high - data.got) / MM
    note = f"nearest to what is not allowed: {markup.fixed(float(np.nanmin(room)), 3)} mm"
    body = chart(lines, x_label="s", y_label="mm", bands=motion.bands)
    return markup.figure("Gap between the tools", body, note)


def wire(data: WireMotion, motion: Motion) -> list[Raw]:
    """Curvature [1/m] and stability of a wire as the proof follows it."""
    out = []
    if data.curvature is not None:
        most = data.max_curvature
        levels = [Level(most, "elastic limit")] if most is not None else []
        top = max(float(np.nanmax(data.curvature)), most or 0.0)
        body = chart(
            [Line("curvature", data.time, data.curvature, 4)],
            x_label="s",
            y_label="1/m",
            bands=motion.bands,
            levels=levels,
            y_range=(0.0, 1.1 * top),
        )
        note = f"greatest: {markup.number(float(np.nanmax(data.curvature)), 3)} /m"
        out.append(markup.figure("Greatest curvature of the wire", body, note))
    if data.stability is not None:
        body = chart(
            [Line("least eigenvalue", data.time, data.stability, 6)],
            x_label="s",
            y_label="relative",
            bands=motion.bands,
            levels=[Level(0.0, "snaps")],
            y_range=(
                min(0.0, float(np.nanmin(data.stability))),
                1.1 * float(np.nanmax(data.stability)) + 1e-9,
            ),
        )
        out.append(markup.figure("Stability of the wire", body, "0 is where it snaps to another shape"))
    return out


def closest_pairs(data: Clearance, count: int = 6) -> Raw:
    """For each pair that is the closest at some time: its least distance, when, and how often."""
    rows: dict[str, tuple[float, float, int]] = {}
    for time, distance, pair in zip(data.time, data.distance, data.pair, strict=True):
        least, when, often = rows.get(pair, (np.inf, 0.0, 0))
        rows[pair] = (min(least, distance), time if distance < least else when, often + 1)
    total = max(len(data.time), 1)
    found = sorted(((v, k) for k, v in rows.items() if k), key=lambda item: item[0][0])[:count]
    cells = [
        (pair, Raw(markup.fixed(v[0] / MM, 1)), Raw(markup.fixed(v[1], 1)), f"{100 * v[2] / total:.0f} %")
        for v, pair in found
    ]
    if not cells:
        return Raw("")
    return markup.figure(
        "Closest pairs", markup.table(("pair", "least [mm]", "at [s]", "closest for"), cells)
    )


def margins(motion: Motion, settings: Settings) -> list[Raw]:
    """Distance to joint limits and to the wrist's singularity over time [deg]."""
    out = []
    for title, attribute, limit in (
        ("Distance to the nearest joint limit", "limit_margin", settings.joint_margin),
        ("Axis 5 from wrist singularity", "wrist_angle", settings.singularity_margin),
    ):
        lines = [
            Line(name, arm.time, getattr(arm, attribute) / DEG, i)
            for i, (name, arm) in enumerate(motion.arms.items())
        ]
        least = min((float(np.min(line.y)) for line in lines), default=0.0)
        note = f"least: {markup.fixed(least, 1)}°"
        if attribute == "wrist_angle" and motion.arms:
            at_work = min(motion.wrist(name) for name in motion.arms)
            note = f"least between targets: {markup.fixed(at_work / DEG, 1)}°"
        body = chart(
            lines,
            x_label="s",
            y_label="deg",
            bands=motion.bands,
            levels=[Level(limit / DEG, "asked for")],
            y_range=(min(0.0, least), max([float(np.max(line.y)) for line in lines] or [1.0]) * 1.08),
        )
        out.append(markup.figure(title, body, note))
    return out


def joints(name: str, arm: ArmMotion, motion: Motion) -> list[Raw]:
    """Six small charts of an arm's joint angles with their limits [deg]."""
    out = []
    for k in range(6):
        lower, upper = arm.robot.lower[k] / DEG, arm.robot.upper[k] / DEG
        angle = arm.q[:, k] / DEG
        low, high = float(angle.min()), float(angle.max())
        air = max(0.15 * (high - low), 8.0)
        near = [Level(v, f"{v:.0f}°") for v in (lower, upper) if low - 40.0 < v < high + 40.0]
        shown = [level.value for level in near]
        body = chart(
            [Line(f"axis {k + 1}", arm.time, angle, k)],
            x_label="s",
            y_label="deg",
            bands=motion.bands,
            levels=near,
            y_range=(min([low - air, *(v - 3 for v in shown)]), max([high + air, *(v + 3 for v in shown)])),
            size=(340.0, 150.0),
        )
        share = f"{low:.1f}° to {high:.1f}° of {lower:.0f}° to {upper:.0f}°".replace("-", "−")
        out.append(markup.figure(f"{name}, axis {k + 1}", body, share))
    return out


def speeds(name: str, arm: ArmMotion, motion: Motion, settings: Settings) -> list[Raw]:
    """Joint speeds, and accelerations where known, as a share of their limits [%]."""
    out = []
    shares = [("speed", arm.speed, arm.robot.velocity, settings.speed_fraction)]
    if arm.acceleration is not None:
        shares.append(
            (
                "acceleration",
                np.asarray(arm.acceleration),
                arm.robot.acceleration,
                settings.acceleration_fraction,
            )
        )
    for what, value, limit, fraction in shares:
        share = 100.0 * np.abs(value) / limit
        most = float(np.nanmax(share))
        lines = [Line(f"axis {k + 1}", arm.time, share[:, k], k) for k in range(6)]
        body = chart(
            lines,
            x_label="s",
            y_label="% of limit",
            bands=motion.bands,
            levels=[Level(100.0 * fraction, "allowed")],
            y_range=(
                0.0,
                most * 1.15 + 1e-6 if most < 40.0 * fraction else max(most * 1.1, 108.0 * fraction),
            ),
        )
        top = int(np.nanargmax(np.nanmax(share, axis=0)))
        allowed = f"{100 * fraction:.0f} % are allowed"
        note = f"highest: axis {top + 1}, {markup.fixed(most, 1)} % of its limit; {allowed}"
        out.append(markup.figure(f"{name}: joint {what}s", body, note))
    return out
