"""``tandem features``: what it prints, draws and refuses."""

from __future__ import annotations

import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import trimesh

from planner.feature_commands import Features, run
from planner.issues import TandemError
from planner.problem import Mesh
from tests.forming.nests import revolved

PROFILE = [(60, 0), (50, 0), (44, -10), (36, -10), (20, 4), (0, 4)]


def written(folder: Path, mesh: Mesh) -> Path:
    path = folder / "part.stl"
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    return path


@pytest.fixture
def part(tmp_path: Path) -> Path:
    return written(tmp_path, revolved([(float(r), float(z)) for r, z in PROFILE]))


def tandem(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "planner", "features", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


def test_the_tree_and_the_order_are_printed(part: Path) -> None:
    done = tandem(str(part), "--strategy", "virgin")
    assert done.returncode == 0, done.stderr
    assert "2 features, flat at z = 0.000 mm" in done.stdout
    assert "1 concave (down) 0.00 to -10.00 mm, 99.9 x 99.9 mm across" in done.stdout  # a radius of 50
    assert "2 convex (up) -10.00 to 4.00 mm" in done.stdout
    assert "order of forming: 2 (moved by +10.00 mm), 1" in done.stdout


def test_bad_parts_end_with_the_code_of_bad_input(tmp_path: Path) -> None:
    part = written(tmp_path, revolved([(60.0, 0.0), (50.0, 0.0), (51.0, -20.0), (0.0, -20.0)]))
    done = tandem(str(part))
    assert done.returncode == 2
    assert "forming.undercut" in done.stderr


@pytest.mark.parametrize("suffix", [".svg", ".html"])
def test_drawings_are_whole_and_show_every_contour(part: Path, tmp_path: Path, suffix: str) -> None:
    drawing = tmp_path / f"tree{suffix}"
    run(Features(part, step_mm=2.0, output=drawing))
    text = drawing.read_text("utf-8")
    svg = text[text.index("<svg") : text.index("</svg>") + 6]
    root = ET.fromstring(svg)
    paths = [element for element in root.iter() if element.tag.endswith("path")]
    assert len(paths) == 6 + 8  # 10 mm and 14 mm every 2 mm, with both ends
    assert all(element.get("d", "").startswith("M") for element in paths)


def test_other_drawings_and_folders_that_are_not_are_refused(part: Path, tmp_path: Path) -> None:
    with pytest.raises(TandemError, match=r"output\.folder.*\.html or \.svg"):
        run(Features(part, output=tmp_path / "tree.png"))
    (tmp_path / "file").write_text("")
    with pytest.raises(TandemError, match=r"output\.folder.*cannot be written"):
        run(Features(part, output=tmp_path / "file" / "tree.svg"))
