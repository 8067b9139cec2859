"""A small picture of the cell, out of a saved report: for lists of many jobs."""

import io
from pathlib import Path
from typing import Final

from PIL import Image

from planner.report import markup

SIZE: Final = (200, 120)
"""Largest width and height [pixels]."""
COLOURS: Final = 128
"""Colours and strengths of a thumbnail: no more are seen in one so small, and it takes 3 kB, not 12."""
MAX_REPORT_BYTES: Final = 50_000_000
"""Bytes of a report beyond which its picture is not looked for."""
MAX_PIXELS: Final = 40_000_000
"""Pixels of a picture beyond which no thumbnail is made of it."""


def thumbnail(report: Path) -> bytes | None:
    """The cell's picture in a report as a small PNG, see-through where nothing is; None where it has none
    that can be read."""
    try:
        if report.stat().st_size > MAX_REPORT_BYTES:
            return None
        found = markup.photo(report.read_text("utf-8"), markup.CELL)
        if found is None:
            return None
        with Image.open(io.BytesIO(found), formats=["PNG"]) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                return None
            small = picture.convert("RGBA")
            small.thumbnail(SIZE)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):  # Pillow's, of what is no PNG
        return None
    stream = io.BytesIO()
    small.quantize(COLOURS, method=Image.Quantize.FASTOCTREE).save(stream, "PNG", optimize=True)
    return stream.getvalue()
