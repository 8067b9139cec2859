"""Thumbnails of cells, extracted from saved reports."""

from __future__ import annotations

import base64
import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from planner.report import thumbnail

SIGNATURE = b"\x89PNG\r\n\x1a\n"


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


def chunk(kind: bytes, content: bytes) -> bytes:
    """A chunk of a PNG."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


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
    huge = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 6, 0, 0, 0)
    for picture in (stream.getvalue(), SIGNATURE + chunk(b"IHDR", huge) + chunk(b"IDAT", b"")):
        report.write_text(report_of(picture))
        assert thumbnail.thumbnail(report) is None


@pytest.mark.parametrize("at", [12, 20, 33, 41, 60, -30, -8])
def test_a_picture_that_is_damaged_is_none_and_ends_nothing(tmp_path: Path, at: int) -> None:
    report, whole = tmp_path / "report.html", noise(90, 50)
    for damaged in (whole[:at], whole[:at] + bytes(4) + whole[at:][4:]):
        report.write_text(report_of(damaged))
        thumbnail.thumbnail(report)  # what Pillow makes of it
