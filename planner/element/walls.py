"""The kinds ``boxes`` and ``puzzle``: division of a ruled wall into numbered panels, or why it fails."""

from collections.abc import Sequence

import numpy as np

from planner.element.boxes import box_piece, divide_boxes, fewest_strips
from planner.element.element_file import PuzzleFile, WallElement
from planner.element.puzzle import divide_puzzle, largest_lobe, lobe_reach, puzzle_pieces
from planner.element.wall_panels import (
    BlockRoom,
    WallPanel,
    WallPiece,
    block_rooms,
    flat_box,
    piece_outline,
    place_in_block,
    sort_panels,
)
from planner.geometry.units import MM
from planner.issues import Issue, TandemError, issue_error


def divide_wall(element: WallElement) -> tuple[WallPanel, ...]:
    """Compute all panels of a wall in the order of their numbers.

    Raises:
        TandemError: ``element.shape`` for lobes that do not fit cells, ``element.block`` if no block holds a
            panel, with a thickness that fits.
    """
    panels = _divide(element, element.file.thickness_mm)
    if panels is None:
        raise TandemError(_too_large(element))
    if isinstance(element.options, PuzzleFile):
        last_row, last_across = max(panel.piece.grid_position for panel in panels)
        _refuse_lobes(element, element.options, (last_row + 1, last_across + 1))
    return sort_panels(panels)


def _divide(element: WallElement, thickness_mm: float) -> tuple[WallPanel, ...] | None:
    """Divide a wall of the given thickness into pieces, and place each piece in a block.

    Returns:
        The panels in no particular order. None if the wall cannot be divided into pieces that fit the blocks,
        or if a piece does not fit any block once it is placed.
    """
    wall = element.wall
    options = element.options
    thickness = thickness_mm * MM
    rooms = block_rooms(element.file)
    foam = (element.file.sides, element.file.faces)  # beside a piece, and above and below it [m]
    if isinstance(options, PuzzleFile):
        pieces = divide_puzzle(wall, thickness, rooms, options.lobe_mm * MM, options.cells)
    else:
        pieces = divide_boxes(wall, thickness, rooms, options.least_height_mm * MM)
    if pieces is None:
        return None
    placed_panels = [place_in_block(wall, piece, thickness, rooms, foam) for piece in pieces]
    panels = tuple(panel for panel in placed_panels if panel is not None)
    return panels if len(panels) == len(placed_panels) else None


def _refuse_lobes(element: WallElement, options: PuzzleFile, cells: tuple[int, int]) -> None:
    """Raise ``element.shape`` if lobes are too large for cells, by their numbers (along the wall, across)."""
    length, width = float(element.wall.nodes[-1]) / cells[0], float(element.wall.widths.min()) / cells[1]
    max_radius = largest_lobe(length, width) / MM
    if options.lobe_mm <= max_radius:
        return
    message = (
        f"lobes of {options.lobe_mm:g} mm do not fit cells of {length / MM:.0f} x {width / MM:.0f} mm, "
        f"allowed {max_radius:.1f} mm"
    )
    hint = f"give lobe_mm: {np.floor(max_radius * 10.0) / 10.0:g}, or fewer cells"
    field = "panels.puzzle.lobe_mm"
    raise issue_error(
        "element.shape", message, field=field, value=options.lobe_mm, limit=max_radius, unit="mm", hint=hint
    )


def _too_large(element: WallElement) -> Issue:
    """Return the issue that not even panels of minimum height fit the blocks, with a thickness that does."""
    file, thickness = element.file, element.file.thickness_mm * MM
    rooms = block_rooms(file)
    pieces = _lowest_pieces(element, rooms)
    boxes = np.array(
        [
            flat_box(
                element.wall,
                piece.along,
                piece.across,
                np.concatenate(piece_outline(element.wall, piece, thickness)),
            )[1]
            for piece in pieces
        ]
    )
    excess = np.min([(boxes - room.size).max(axis=1) for room in rooms], axis=0)
    worst_index = int(np.argmax(excess))
    foam = 2.0 * np.array([file.sides, file.sides, file.faces])
    got, needed, largest = (
        " x ".join(f"{v / MM:.0f}" for v in np.ceil(size / MM) * MM)
        for size in (boxes[worst_index] + foam, boxes.max(axis=0) + foam, rooms[-1].size + foam)
    )
    u, t = (np.mean(v) for v in (pieces[worst_index].along, pieces[worst_index].across))
    at = ", ".join(f"{v / MM:.0f}" for v in element.wall.points(np.array([u]), np.array([t]))[0])
    text = (
        f"no block holds a panel near ({at}) mm, although it is only "
        f"{np.ptp(pieces[worst_index].along) / MM:.0f} mm high: with foam around it, it needs {got} mm, the "
        f"largest block has {largest} mm within the span of the bow"
    )
    fitting = _thickness_that_fits(element)
    hint = f"blocks of {needed} mm would hold the lowest panels, or give smaller ones"
    if fitting is not None:
        hint = f"thickness_mm: {fitting:g} would fit; {hint}"
    return Issue(
        "element.block",
        text,
        field="blocks",
        value=float(excess[worst_index]) / MM,
        limit=0,
        unit="mm",
        hint=hint,
    )


def _lowest_pieces(element: WallElement, rooms: Sequence[BlockRoom]) -> tuple[WallPiece, ...]:
    """Return pieces of about minimum height that cover the wall."""
    wall, options = element.wall, element.options
    length = float(wall.nodes[-1])
    if isinstance(options, PuzzleFile):
        radius = options.lobe_mm * MM
        across, rows = options.cells or (
            fewest_strips(wall, rooms, lobe_reach(radius)),
            int(length / (3.0 * radius)),
        )
        return puzzle_pieces(wall, element.file.thickness_mm * MM, radius, across, max(1, rows))
    count = max(1, int(length / (options.least_height_mm * MM)))
    strips = fewest_strips(wall, rooms)
    u, t = np.linspace(0.0, length, count + 1), np.linspace(0.0, 1.0, strips + 1)
    return tuple(
        box_piece(wall, (k, i), (float(u[i]), float(u[i + 1])), (float(t[k]), float(t[k + 1])))
        for k, i in np.ndindex(strips, count)
    )


def _thickness_that_fits(element: WallElement) -> float | None:
    """Return the largest whole thickness [mm] below the requested one with which all panels fit, or None."""
    low, high = 0, int(np.ceil(element.file.thickness_mm))
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if _divide(element, middle) is not None else (low, middle)
    return float(low) if low else None
