"""SVG drawing of an arm with its axes: its shapes at home, and the positive sense of each joint."""

import html
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.bodies import body_poses, link_chain
from planner.geometry.arrays import FloatArray, Shape
from planner.report import markup, raster
from planner.report.raster import RenderItem, RenderSolid

_LINK_COLOURS: Final = ((0.62, 0.66, 0.72), (0.80, 0.83, 0.87))
"""Red, green, blue in 0..1 of alternate links."""
_VIEW_DIRECTION: Final = np.array([-0.62, 0.86, -0.34])
"""View direction, in the base frame."""
_WIDTH, _HEIGHT = 900, 760
_SOLID_BUILDERS: Final[Mapping[str, Callable[..., RenderSolid]]] = {
    "box": raster.box,
    "cylinder": raster.cylinder,
    "capsule": raster.capsule,
    "sphere": raster.sphere,
}
_AXIS_COLOUR, _FRAME_COLOURS = "#7d3c98", ("#c0392b", "#2e8b57", "#2e5fb8")


def drawing(robot: RobotData) -> str:
    """Draw an arm from a file at home, with numbered axes and the base and tip frames.

    Arrows point along positive rotation.

    Args:
        robot: Robot that was read from a file.

    Returns:
        SVG text.

    Raises:
        ValueError: The robot is from the catalogue. Drake reads its bodies.
    """
    if robot.file is None:
        raise ValueError(f"{robot.name} is not from a file")
    poses = body_poses("arm", robot, np.eye(4), robot.home[None])
    names = link_chain(robot.axes)[:-1]
    things = [
        RenderItem(
            _solid(shape).moved(poses[f"arm/{name}"][0] @ shape.pose), _LINK_COLOURS[i % 2], closed=False
        )
        for i, (name, shapes) in enumerate(zip(names, robot.file.shapes, strict=True))
        for shape in shapes
    ]
    frames = np.concatenate([poses[f"arm/{name}"] for name in names[1:]])
    zero = robot.file.zero[1:-1, :3, :3]
    axes = np.einsum("iab,icb,ic->ia", frames[:, :3, :3], zero, robot.file.axis)  # turned with the links
    points, tip = _label_points(frames[:, :3, 3], axes), poses["arm/tool"][0]
    half = 0.14 * robot.reach
    ends = np.stack([points - half * axes, points + half * axes], axis=1)
    triads = np.stack([np.eye(4), tip])
    arrows = triads[:, None, :3, 3] + 0.8 * half * np.swapaxes(triads[:, :3, :3], 1, 2)
    shown = np.concatenate([*(thing.solid.vertices for thing in things), *ends, *arrows])
    camera = raster.frame_camera(shown, _VIEW_DIRECTION, 2 * _WIDTH, 2 * _HEIGHT, 0.88)
    image = raster.render_items(camera, things)
    address = markup.png(image.color, np.isfinite(image.depth).astype(np.float64))

    def to_pixels(position: FloatArray) -> FloatArray:
        return np.asarray(0.5 * camera.project(position)[..., :2])

    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        f'font-family="sans-serif" font-size="15"><title>{html.escape(robot.title)}</title>',
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="#fff"/>',
        f'<image href="{address}" width="{_WIDTH}" height="{_HEIGHT}"/>',
        f'<text x="16" y="28" font-size="18">{html.escape(robot.title)}, at home</text>',
    ]
    for origin, heads, word in zip(
        to_pixels(triads[:, :3, 3]), to_pixels(arrows), ("base", "tip"), strict=True
    ):
        out += [_arrow(origin, head, paint, 2.0) for head, paint in zip(heads, _FRAME_COLOURS, strict=True)]
        out.append(_label(origin, word, "#1b2330"))
    for i, (start, end) in enumerate(to_pixels(ends)):
        out += [_arrow(start, end, _AXIS_COLOUR, 2.6), _label(end, str(i + 1), _AXIS_COLOUR)]
    return "\n".join([*out, "</svg>"]) + "\n"


def _label_points(points: FloatArray, axes: FloatArray) -> FloatArray:
    """Choose points (N, 3) on the axes (N, 3), so that no two labels coincide.

    If a later axis is collinear with one, as axis 6 with axis 4 at home, the earlier point moves half the
    way back to the previous axis.
    """
    out = points.copy()
    for i in range(1, len(points)):
        for j in range(i + 1, len(points)):
            distance = np.linalg.norm(np.cross(points[j] - points[i], axes[i]))
            if distance < 1e-3 and np.linalg.norm(np.cross(axes[i], axes[j])) < 1e-3:
                offset = (points[i - 1] - points[j]) @ axes[i]
                out[i] = points[j] + 0.5 * offset * axes[i]
    return out


def _solid(shape: Shape) -> RenderSolid:
    if shape.vertices is not None and shape.faces is not None:
        return raster.mesh(shape.vertices, shape.faces)
    return _SOLID_BUILDERS[shape.kind](*shape.size)


def _arrow(start: FloatArray, end: FloatArray, colour: str, width: float) -> str:
    direction = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    across = np.array([-direction[1], direction[0]])
    wings = [end - 11.0 * direction + 4.5 * across, end, end - 11.0 * direction - 4.5 * across]
    head = " ".join(f"{x:.1f},{y:.1f}" for x, y in wings)
    return (
        f'<path d="M{start[0]:.1f},{start[1]:.1f} L{end[0]:.1f},{end[1]:.1f}" stroke="{colour}" '
        f'stroke-width="{width}"/><polygon points="{head}" fill="{colour}"/>'
    )


def _label(position: FloatArray, text: str, colour: str) -> str:
    halo = 'stroke="#fff" stroke-width="4" paint-order="stroke"'
    x, y = position + 8.0
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" {halo}>{html.escape(text)}</text>'
