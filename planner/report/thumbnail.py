"""Thumbnail of the cell from a saved report, for lists of jobs."""

import io
from pathlib import Path
from typing import Final

from PIL import Image

from planner.report import markup

MAX_SIZE: Final = (200, 120)
"""Maximum width and height [px]."""
COLOUR_COUNT: Final = 128
"""Number of colours with opacity.

More are not visible at this size, and the file takes 3 kB instead of 12.
"""
MAX_REPORT_BYTES: Final = 50_000_000
"""Maximum size [bytes] of a report that is searched for its picture."""
MAX_PIXELS: Final = 40_000_000
"""Maximum number of pixels of a picture that gets a thumbnail."""


def thumbnail(report: Path) -> bytes | None:
    """Return the picture of the cell in a report as a small PNG with transparency.

    Args:
        report: Path of ``report.html``.

    Returns:
        PNG, or None if there is no readable picture.
    """
    try:
        if report.stat().st_size > MAX_REPORT_BYTES:
            return None
        photo = markup.extract_photo(report.read_text("utf-8"), markup.CELL_PICTURE_NAME)
        if photo is None:
            return None
        with Image.open(io.BytesIO(photo), formats=["PNG"]) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                return None
            image = picture.convert("RGBA")
            image.thumbnail(MAX_SIZE)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):  # Pillow on invalid PNGs
        return None
    stream = io.BytesIO()
    image.quantize(COLOUR_COUNT, method=Image.Quantize.FASTOCTREE).save(stream, "PNG", optimize=True)
    return stream.getvalue()
