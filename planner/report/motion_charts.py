"""Charts of a motion: feed, clearance, margins, joint angles and speeds against their limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.problem import Settings
from planner.report import markup
from planner.report.charts import Level, Line, chart
from planner.report.inputs import ArmMotion, Clearance, Motion
from planner.report.markup import Raw
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]


def feed(motion: Motion) -> Raw:
    """Speed of the fastest guarded point against the window that the process asks for [mm/s]."""
    f = motion.feed
    cut = f.lower > 0.0
    lines = [Line("speed", f.time, f.speed / MM, 0)]
    lines.append(
        Line("highest allowed", f.time, np.where(np.isfinite(f.upper), f.upper / MM, np.nan), 1, True)
    )
    if cut.any():
        lines.append(Line("lowest allowed", f.time, np.where(cut, f.lower / MM, np.nan), 3, True))
    work = np.isfinite(f.speed) & cut
    top = (
        2.2 * float(np.max(f.upper[work])) / MM
        if work.any()
        else float(np.nanmax(f.speed, initial=1e-3)) * 1.2 / MM
    )
    body = chart(lines, x_label="s", y_label="mm/s", bands=motion.bands, y_range=(0.0, top))
    note = (
        f"scaled to the work; moves outside it reach {markup.number(float(np.nanmax(f.speed)) / MM, 3)} mm/s"
    )
    fast = bool(np.nanmax(f.speed, initial=0.0) / MM > top)
    return markup.figure("Speed of the fastest guarded point", body, note if fast else "tinted: cutting")


def clearance(data: Clearance, motion: Motion, settings: Settings) -> Raw:
    """Least distance over time [mm] with the asked one, and the pairs that come closest."""
    body = chart(
        [Line("clearance", data.time, data.distance / MM, 2)],
        x_label="s",
        y_label="mm",
        bands=motion.bands,
        levels=[Level(settings.clearance / MM, "asked for")],
        y_range=(0.0, float(min(np.nanmax(data.distance), 0.15)) / MM * 1.1 + 1.0),
    )
    worst = int(np.nanargmin(data.distance))
    at = f"{markup.fixed(data.distance[worst] / MM, 1)} mm at {markup.fixed(data.time[worst], 1)} s"
    note = f"least: {at}" + (f", {data.pair[worst]}" if data.pair[worst] else "")
    return markup.figure("Clearance of everything to everything", body, note)


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
        body = chart(
            lines,
            x_label="s",
            y_label="deg",
            bands=motion.bands,
            levels=[Level(limit / DEG, "asked for")],
            y_range=(min(0.0, least), max([float(np.max(line.y)) for line in lines] or [1.0]) * 1.08),
        )
        out.append(markup.figure(title, body, f"least: {markup.fixed(least, 1)}°"))
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
