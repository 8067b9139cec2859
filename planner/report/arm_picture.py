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
"""Size of the drawing [px]."""
_SOLID_BUILDERS: Final[Mapping[str, Callable[..., RenderSolid]]] = {
    "box": raster.box,
    "cylinder": raster.cylinder,
    "capsule": raster.capsule,
    "sphere": raster.sphere,
}
"""Functions that build a solid from the size of a shape, by kind of shape."""
_AXIS_COLOUR = "#7d3c98"
"""Colour of the joint axes and their numbers."""
_FRAME_COLOURS = ("#c0392b", "#2e8b57", "#2e5fb8")
"""Colours of the x, y and z axis of a frame."""


def drawing(robot: RobotData) -> str:
    """Draw an arm from a file at home, with numbered joint axes and the base and tip frames.

    The arrow of a joint axis points such that positive rotation follows the right-hand rule.

    Args:
        robot: Robot that was read from a file.

    Returns:
        SVG text.

    Raises:
        ValueError: The robot is from the catalogue, so that only Drake has its shapes.
    """
    if robot.file is None:
        raise ValueError(f"{robot.name} is not from a file")
    poses = body_poses("arm", robot, np.eye(4), robot.home[None])
    # base and links of the arm, without the tool
    names = link_chain(robot.axes)[:-1]
    items = [
        RenderItem(
            _solid(shape).moved(poses[f"arm/{name}"][0] @ shape.pose), _LINK_COLOURS[i % 2], closed=False
        )
        for i, (name, shapes) in enumerate(zip(names, robot.file.shapes, strict=True))
        for shape in shapes
    ]
    frames = np.concatenate([poses[f"arm/{name}"] for name in names[1:]])
    # The file states axes in the base frame with all joints at zero. They rotate with their links to home.
    zero = robot.file.zero[1:-1, :3, :3]
    axes = np.einsum("iab,icb,ic->ia", frames[:, :3, :3], zero, robot.file.axis)
    points = _label_points(frames[:, :3, 3], axes)
    tip = poses["arm/tool"][0]
    half_length = 0.14 * robot.reach
    ends = np.stack([points - half_length * axes, points + half_length * axes], axis=1)
    end_frames = np.stack([np.eye(4), tip])
    frame_arrows = end_frames[:, None, :3, 3] + 0.8 * half_length * np.swapaxes(end_frames[:, :3, :3], 1, 2)
    visible_points = np.concatenate([*(item.solid.vertices for item in items), *ends, *frame_arrows])
    # The image is rendered at twice the size of the drawing, so that it stays sharp when enlarged.
    camera = raster.frame_camera(visible_points, _VIEW_DIRECTION, 2 * _WIDTH, 2 * _HEIGHT, fill=0.88)
    image = raster.render_items(camera, items)
    image_url = markup.png(image.color, np.isfinite(image.depth).astype(np.float64))

    def to_pixels(position: FloatArray) -> FloatArray:
        return np.asarray(0.5 * camera.project(position)[..., :2])

    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        f'font-family="sans-serif" font-size="15"><title>{html.escape(robot.title)}</title>',
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="#fff"/>',
        f'<image href="{image_url}" width="{_WIDTH}" height="{_HEIGHT}"/>',
        f'<text x="16" y="28" font-size="18">{html.escape(robot.title)}, at home</text>',
    ]
    for frame_origin, arrow_heads, frame_name in zip(
        to_pixels(end_frames[:, :3, 3]), to_pixels(frame_arrows), ("base", "tip"), strict=True
    ):
        out += [
            _arrow(frame_origin, head, colour, 2.0)
            for head, colour in zip(arrow_heads, _FRAME_COLOURS, strict=True)
        ]
        out.append(_label(frame_origin, frame_name, "#1b2330"))
    for i, (start, end) in enumerate(to_pixels(ends)):
        out += [_arrow(start, end, _AXIS_COLOUR, 2.6), _label(end, str(i + 1), _AXIS_COLOUR)]
    return "\n".join([*out, "</svg>"]) + "\n"


def _label_points(points: FloatArray, axes: FloatArray) -> FloatArray:
    """Choose a point (N, 3) [m] on each joint axis for its number, so that no two labels coincide.

    By default it is the origin of the link, one of ``points`` (N, 3). If a later axis is collinear with an
    earlier one, as axis 6 with axis 4 at home, the point of the earlier one moves half the way back to the
    previous axis. ``axes`` (N, 3) are unit vectors.
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
    """Return the triangles of a collision shape, in the frame of the shape."""
    if shape.vertices is not None and shape.faces is not None:
        return raster.mesh(shape.vertices, shape.faces)
    return _SOLID_BUILDERS[shape.kind](*shape.size)


def _arrow(start: FloatArray, end: FloatArray, colour: str, width: float) -> str:
    """Return an SVG arrow from ``start`` to ``end`` (2,) [px], with a head of 11 by 9 px."""
    direction = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    across = np.array([-direction[1], direction[0]])
    head_corners = [end - 11.0 * direction + 4.5 * across, end, end - 11.0 * direction - 4.5 * across]
    head_points = " ".join(f"{x:.1f},{y:.1f}" for x, y in head_corners)
    return (
        f'<path d="M{start[0]:.1f},{start[1]:.1f} L{end[0]:.1f},{end[1]:.1f}" stroke="{colour}" '
        f'stroke-width="{width}"/><polygon points="{head_points}" fill="{colour}"/>'
    )


def _label(position: FloatArray, text: str, colour: str) -> str:
    """Return an SVG label with a white outline, to the lower right of a position (2,) [px]."""
    halo = 'stroke="#fff" stroke-width="4" paint-order="stroke"'
    x, y = position + 8.0
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" {halo}>{html.escape(text)}</text>'
