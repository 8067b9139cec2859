"""The kinds ``boxes`` and ``puzzle``: a ruled wall divided, its panels in blocks and numbered, or why not."""

from collections.abc import Sequence

import numpy as np

from planner.element.boxes import box_piece, divide_boxes, fewest_strips
from planner.element.element_file import PuzzleFile, WallElement
from planner.element.puzzle import divide_puzzle, largest_lobe, puzzle_pieces, reach
from planner.element.wall_panels import Piece, Room, WallPanel, flat_box, in_block, numbered, outline, rooms
from planner.geometry.units import MM
from planner.issues import Issue, TandemError, refusal


def divide_wall(element: WallElement) -> tuple[WallPanel, ...]:
    """All panels of a wall by their numbers.

    Raises ``TandemError``: ``element.shape`` for lobes that cells have no room for, ``element.block`` where
    no block holds a panel, with the thickness that would fit.
    """
    panels = _divided(element, element.file.thickness_mm)
    if panels is None:
        raise TandemError(_too_large(element))
    if isinstance(element.wanted, PuzzleFile):
        rows, across = max(panel.piece.place for panel in panels)
        _refuse_lobes(element, element.wanted, (rows + 1, across + 1))
    return numbered(panels)


def _divided(element: WallElement, thickness_mm: float) -> tuple[WallPanel, ...] | None:
    wall, wanted, thickness = element.wall, element.wanted, thickness_mm * MM
    own, foam = rooms(element.file), (element.file.sides, element.file.faces)
    if isinstance(wanted, PuzzleFile):
        pieces = divide_puzzle(wall, thickness, own, wanted.lobe_mm * MM, wanted.cells)
    else:
        pieces = divide_boxes(wall, thickness, own, wanted.least_height_mm * MM)
    if pieces is None:
        return None
    made = [in_block(wall, piece, thickness, own, foam) for piece in pieces]
    whole = tuple(panel for panel in made if panel is not None)
    return whole if len(whole) == len(made) else None


def _refuse_lobes(element: WallElement, wanted: PuzzleFile, cells: tuple[int, int]) -> None:
    """Refuse lobes that reach into one another in cells, so many along the wall and across."""
    length, width = float(element.wall.nodes[-1]) / cells[0], float(element.wall.widths.min()) / cells[1]
    most = largest_lobe(length, width) / MM
    if wanted.lobe_mm <= most:
        return
    what = (
        f"lobes of {wanted.lobe_mm:g} mm have no room in cells of {length / MM:.0f} x {width / MM:.0f} mm, "
        f"at most {most:.1f} mm have"
    )
    hint = f"give lobe_mm: {np.floor(most * 10.0) / 10.0:g}, or fewer cells"
    field = "panels.puzzle.lobe_mm"
    raise refusal("element.shape", what, field=field, value=wanted.lobe_mm, limit=most, unit="mm", hint=hint)


def _too_large(element: WallElement) -> Issue:
    """The lowest panel that no block holds by most, and the thickness that would fit."""
    file, thickness = element.file, element.file.thickness_mm * MM
    own = rooms(file)
    pieces = _lowest(element, own)
    boxes = np.array(
        [
            flat_box(
                element.wall, one.along, one.across, np.concatenate(outline(element.wall, one, thickness))
            )[1]
            for one in pieces
        ]
    )
    over = np.min([(boxes - room.size).max(axis=1) for room in own], axis=0)
    worst = int(np.argmax(over))
    around = 2.0 * np.array([file.sides, file.sides, file.faces])
    got, needed, has = (
        " x ".join(f"{v / MM:.0f}" for v in np.ceil(size / MM) * MM)
        for size in (boxes[worst] + around, boxes.max(axis=0) + around, own[-1].size + around)
    )
    u, t = (np.mean(v) for v in (pieces[worst].along, pieces[worst].across))
    at = ", ".join(f"{v / MM:.0f}" for v in element.wall.points(np.array([u]), np.array([t]))[0])
    what = (
        f"no block holds a panel near ({at}) mm, though it is only "
        f"{np.ptp(pieces[worst].along) / MM:.0f} mm high: with foam beside it, it takes {got} mm, the "
        f"largest block has {has} mm within the span of the bow"
    )
    thin = _thickness_that_fits(element)
    hint = f"blocks of {needed} mm would hold the lowest panels, or give smaller ones"
    if thin is not None:
        hint = f"thickness_mm: {thin:g} would fit; {hint}"
    return Issue(
        "element.block", what, field="blocks", value=float(over[worst]) / MM, limit=0, unit="mm", hint=hint
    )


def _lowest(element: WallElement, own: Sequence[Room]) -> tuple[Piece, ...]:
    """Panels as low as they may be, all over the wall."""
    wall, wanted = element.wall, element.wanted
    length = float(wall.nodes[-1])
    if isinstance(wanted, PuzzleFile):
        radius = wanted.lobe_mm * MM
        across, rows = wanted.cells or (fewest_strips(wall, own, reach(radius)), int(length / (3.0 * radius)))
        return puzzle_pieces(wall, element.file.thickness_mm * MM, radius, across, max(1, rows))
    count, strips = max(1, int(length / (wanted.least_height_mm * MM))), fewest_strips(wall, own)
    u, t = np.linspace(0.0, length, count + 1), np.linspace(0.0, 1.0, strips + 1)
    return tuple(
        box_piece(wall, (k, i), (float(u[i]), float(u[i + 1])), (float(t[k]), float(t[k + 1])))
        for k, i in np.ndindex(strips, count)
    )


def _thickness_that_fits(element: WallElement) -> float | None:
    """The largest thickness in whole millimetres below the wanted one with which all panels fit."""
    low, high = 0, int(np.ceil(element.file.thickness_mm))
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if _divided(element, middle) is not None else (low, middle)
    return float(low) if low else None
