"""Small pictures of cells, out of saved reports."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
from PIL import Image

from planner.report import thumbnail


def report_of(picture: bytes) -> str:
    address = f"data:image/png;base64,{base64.b64encode(picture).decode()}"
    return f'<img alt="the cell" src="{address}">'


def noise(width: int, height: int) -> bytes:
    """A PNG that is as large as one can be, red on its left half, and see-through in its upper quarter."""
    pixels = np.random.default_rng(1).integers(0, 256, (height, width, 4), np.uint8)
    pixels[:, : width // 2] = (255, 0, 0, 255)
    pixels[: height // 4] = 0
    stream = io.BytesIO()
    Image.fromarray(pixels, "RGBA").save(stream, "PNG")
    return stream.getvalue()


def test_thumbnails_come_from_reports_and_from_nothing_else(tmp_path: Path) -> None:
    report = tmp_path / "report.html"
    report.write_text(report_of(noise(900, 300)))
    small = thumbnail.thumbnail(report)
    assert small is not None and len(small) <= 15_000
    with Image.open(io.BytesIO(small)) as picture:
        assert (picture.size, picture.format) == ((200, 67), "PNG")
        seen = np.asarray(picture.convert("RGBA"))
    assert np.abs(seen[40, 20].astype(int) - (255, 0, 0, 255)).max() < 30
    assert seen[2, :, 3].max() == 0
    assert thumbnail.thumbnail(report) == small
    for none in (report_of(b"GIF89a"), report_of(noise(9, 9)).replace("the cell", "the part"), "", "\ud800"):
        report.write_bytes(none.encode("utf-8", "surrogatepass"))
        assert thumbnail.thumbnail(report) is None
    assert thumbnail.thumbnail(tmp_path / "none.html") is None


def test_pictures_that_are_too_large_are_left_out(tmp_path: Path) -> None:
    report, stream = tmp_path / "report.html", io.BytesIO()
    Image.new("1", (10_000, 4_001)).save(stream, "PNG")
    report.write_text(report_of(stream.getvalue()))
    assert thumbnail.thumbnail(report) is None
