"""The page and the labels of an element: their content, read by independent test code."""

from __future__ import annotations

import itertools
import json
import math
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import matplotlib as mpl
import numpy as np
import pytest
import shapely
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

from planner.cli.element import ElementRequest, run_element
from planner.element import element_page, labels, run_report
from tests.element.shells import shell
from tests.element.walls import element

SVG = "{http://www.w3.org/2000/svg}"
CORE = Path(mpl.get_data_path()) / "fonts" / "pdfcorefonts"
RAW = {"sizes": [{"size_mm": [2400, 1200, 150], "foam": "eps_a120"}], "kerf_mm": 2}


@pytest.fixture(scope="module", params=["hexagons", "elastic"])
def out(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp(request.param)
    path = (
        shell(folder, hexagons={"count": 41}, raw_blocks=RAW)
        if request.param == "hexagons"
        else element(folder)
    )
    run_element(ElementRequest(path, folder / "out"))
    return folder / "out"


def read_data(out: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((out / "element.json").read_text())
    return loaded


def test_outlines_meet_where_neighbours_are_named_and_cover_the_element_once(out: Path) -> None:
    panels = {panel["id"]: panel for panel in read_data(out)["panels"]}
    shapes = {name: shapely.Polygon(panel["outline_mm"]) for name, panel in panels.items()}
    whole = shapely.unary_union(list(shapes.values()))
    assert whole.area == pytest.approx(sum(shape.area for shape in shapes.values()), rel=1e-3)
    for name, panel in panels.items():
        ring = np.array(panel["outline_mm"])
        assert shapely.LinearRing(ring).is_ccw
        assert len(panel["neighbours"]) == len(ring)
        for i, beyond in enumerate(panel["neighbours"]):
            edge = shapely.LineString([ring[i], ring[(i + 1) % len(ring)]])
            near = {n for n, item in shapes.items() if n != name and item.buffer(0.1).contains(edge)}
            assert near == ({beyond} if beyond is not None else set())


def test_ids_are_drawn_within_their_outlines(out: Path) -> None:
    """As wide as Matplotlib sets them in its bold type."""
    page = (out / "element.html").read_text()
    on_page = re.search(r'<svg[^>]*aria-label="panels".*?</svg>', page, re.DOTALL)
    assert on_page is not None
    bold = FontProperties(family="DejaVu Sans", weight="bold")
    alone = (out / "panels.svg").read_text()
    for drawn in (on_page[0], *([alone] if "<polygon" in alone else [])):  # elastic ones stand in rectangles
        result = ET.fromstring(re.sub(r' xmlns="[^"]*"', "", drawn))
        marks = [item for item in result.iter() if item.tag in ("polygon", "text")]
        outline, ids = None, 0
        for mark in marks:
            if mark.tag == "polygon":
                outline = shapely.Polygon(
                    [tuple(map(float, p.split(","))) for p in mark.attrib["points"].split()]
                )
            elif outline is not None:
                size = re.search(r"font-size[:=]\"?([\d.]+)", ET.tostring(mark, "unicode"))
                assert size is not None and mark.text is not None
                low, high = (
                    TextPath((0, 0), mark.text, size=float(size[1]), prop=bold).get_extents().get_points()
                )
                x, y = float(mark.attrib["x"]), float(mark.attrib["y"])
                half = 0.5 * (high[0] - low[0])
                assert outline.buffer(1.0).contains(shapely.box(x - half, y - high[1], x + half, y)), (
                    mark.text
                )
                outline, ids = None, ids + 1
        assert ids == len(read_data(out)["panels"])


def test_the_page_shows_all_panels_blocks_totals_and_an_estimate_and_needs_no_network(out: Path) -> None:
    data = read_data(out)
    page = (out / "element.html").read_text()
    names = [panel["id"] for panel in data["panels"]]
    drawing = page[page.index('aria-label="panels"') : page.index("</svg>")]
    assert all(f">{name}<" in drawing for name in names)
    behind = page[page.index('aria-label="panels from behind"') :]
    behind = behind[: behind.index("</svg>")]
    places = r'<text x="([0-9.]+)" y="([0-9.]+)"[^>]*>{}<'
    for name in names:  # left and right change places, up and down do not
        (x, y), (other, also) = (
            map(float, re.findall(places.format(name), item)[0]) for item in (drawing, behind)
        )
        assert (x + other, y) == pytest.approx((1000.0, also), abs=40.0)
    rows = page[page.index('id="panels"') :]
    assert all(f"<td>{name}</td>" in rows for name in names)
    assert not re.search(r"(src|href)=\"(?!#|data:)", page)
    weight = sum(float(panel["weight_kg"]) for panel in data["panels"])
    assert f"{weight:.1f} kg" in page
    hours = sum(panel["cut_min"]["left"] for panel in data["panels"]) / 60.0
    assert f"about {hours:.1f} h, {60.0 * hours / len(names):.1f} min a panel: an estimate" in page
    if "blocks" in data:
        nest = data["blocks"]
        assert f"{len(nest['blocks'])} of 2400 x 1200 x 150 mm" in page
        assert all(f"<td>{block['id']}</td>" in page for block in nest["blocks"])
        volume = sum(float(panel["volume_l"]) for panel in data["panels"]) / 1e3
        fraction = volume / (len(nest["blocks"]) * 2.4 * 1.2 * 0.15)
        assert nest["yield_volume"] == pytest.approx(fraction, abs=1e-3)
        assert f"{100 * fraction:.0f} % are panels" in page
    assert all(issue["code"] in page for issue in data["issues"])
    metres = 0.06 * hours * 60.0 * (6.0 if "hexagon" in out.parent.name else 8.0)
    assert re.search(rf"wire through foam</\w+>.*?{metres:.0f} m<", page)
    assert f"{len(names)} in {len(names)} jobs: to bring foam" in page


def test_the_estimate_is_the_way_of_the_wire_at_its_feed(out: Path) -> None:
    """6 mm/s round a hexagon; 8 mm/s twice along the block of an elastic panel."""
    for panel in read_data(out)["panels"]:
        if "front_mm" in panel:
            sides = [np.array(panel[key]) for key in ("front_mm", "back_mm")]
            way = sum(np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).sum() / 2 for ring in sides)
            assert panel["cut_min"]["left"] == pytest.approx(way / 6.0 / 60.0, rel=2e-3)
        else:
            assert panel["cut_min"]["left"] == pytest.approx(
                2 * float(panel["block_y_mm"]) / 8.0 / 60.0, abs=1e-3
            )


def test_what_is_said_of_an_element_is_on_its_page_as_text(out: Path) -> None:
    data = read_data(out)
    said = {"code": "element.held", "severity": "warning", "message": "2 <b>panels</b>: A01, A02"}
    page = element_page.element_page(run_report.unplanned_run({**data, "issues": [said]}))
    assert "2 &lt;b&gt;panels&lt;/b&gt;: A01, A02" in page


def label_words(label: ET.Element) -> list[tuple[str, shapely.Polygon, float]]:
    """Words with the room they take [mm], a letter 0.6 of its type wide, capitals 0.72 high, and the size of
    their type."""
    result = []
    for text in label.iter(f"{SVG}text"):
        words, size = str(text.text), float(text.attrib["font-size"])
        x, y, half = float(text.attrib["x"]), float(text.attrib["y"]), 0.3 * size * len(str(text.text))
        result.append((words, shapely.box(x - half, y - 0.72 * size, x + half, y), size))
    return result


def test_labels_are_at_full_size_legible_and_say_whom_each_edge_meets(out: Path) -> None:
    data = read_data(out)
    sheet = ET.parse(out / "labels.svg").getroot()
    high = float(sheet.attrib["viewBox"].split()[3])
    assert (sheet.attrib["width"], sheet.attrib["height"]) == ("210mm", f"{high:g}mm")
    assert sheet.attrib["viewBox"] == f"0 0 210 {high:g}"
    assert high % 297 == 0
    result = {group.attrib["id"]: group for group in sheet.iter(f"{SVG}g")}
    assert list(result) == [panel["id"] for panel in data["panels"]]
    corners = {group.attrib["transform"] for group in result.values()}
    assert len(corners) == len(result)
    for panel in data["panels"]:
        label = result[panel["id"]]
        words = label_words(label)
        assert sorted(w for w, _, _ in words) == sorted(
            [panel["id"], "front", *filter(None, panel["neighbours"])]
        )
        assert min(0.72 * size for _, _, size in words) >= 5.0
        for (_, item, _), (_, other, _) in itertools.combinations(words, 2):
            assert not item.intersects(other)
        (shape,) = label.iter(f"{SVG}polygon")
        ring = np.array([[float(v) for v in at.split(",")] for at in shape.attrib["points"].split()])
        label_room = shapely.box(3.0, 3.0, 102.0, 71.25)
        assert all(label_room.contains(item) for _, item, _ in words)
        assert not any(shapely.Polygon(ring).intersects(item) for _, item, _ in words)
        assert sum(line.attrib["stroke-width"] == "1.4" for line in label.iter(f"{SVG}line")) == (
            panel["neighbours"].count(None)
        )


def test_each_id_stands_nearest_to_its_own_edge_and_up_is_up(out: Path) -> None:
    data = read_data(out)
    sheet = ET.parse(out / "labels.svg").getroot()
    for group, panel in zip(sheet.iter(f"{SVG}g"), data["panels"], strict=True):
        (shape,) = group.iter(f"{SVG}polygon")
        ring = np.array([[float(v) for v in at.split(",")] for at in shape.attrib["points"].split()])
        # the same outline as in the data, turned so that its up is upwards, not mirrored
        own = np.array(panel.get("front_mm", panel["outline_mm"]))
        x, y = panel.get("up", (0.0, 1.0))
        flat = np.stack([own @ [y, -x], own @ [x, y]], axis=1) * [1.0, -1.0]
        scale = np.ptp(ring[:, 1]) / np.ptp(flat[:, 1])
        np.testing.assert_allclose(ring - ring.mean(axis=0), scale * (flat - flat.mean(axis=0)), atol=0.05)
        words = {text: at for text, at, _ in label_words(group)}
        for i, beyond in enumerate(panel["neighbours"]):
            if beyond is None or panel["neighbours"].count(beyond) > 1:
                continue
            edges = [shapely.LineString([ring[k], ring[(k + 1) % len(ring)]]) for k in range(len(ring))]
            gaps = [edge.distance(words[beyond]) for edge in edges]
            assert gaps[i] <= min(gaps) + 6.0


def test_the_document_of_the_labels_is_sheets_of_a4_with_the_same_words_in_the_same_places(out: Path) -> None:
    """Read by the rules of ISO 32000-1 (a table at the end states where each object begins).

    Text widths are Adobe's metrics, which Matplotlib includes.
    """
    text = (out / "labels.pdf").read_text("ascii")
    table = int(text.split("startxref\n")[1].split("\n")[0])
    rows = text[table:].split("trailer")[0].split("\n")[3:-1]
    starts = [int(row[:10]) for row in rows]
    assert all(text[at:].startswith(f"{number} 0 obj\n") for number, at in enumerate(starts, 1))
    assert all(len(row) == 19 for row in rows)  # and the end of the line
    box = re.search(r"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", text)
    assert box is not None
    assert [float(v) / 72.0 * 25.4 for v in box.groups()] == pytest.approx([210.0, 297.0], abs=1e-3)
    pages = re.findall(r"<< /Length (\d+) >>\nstream\n(.*?)endstream", text, re.DOTALL)
    assert [int(length) for length, _ in pages] == [len(page) for _, page in pages]
    assert f"/Count {len(pages)} " in text and len(pages) == math.ceil(len(read_data(out)["panels"]) / 8)
    metrics = [
        {chr(int(code)): int(width) for code, width in re.findall(r"C (\d+) ; WX (\d+)", file.read_text())}
        for file in (CORE / "Helvetica.afm", CORE / "Helvetica-Bold.afm")
    ]
    result = []
    for number, (_, page) in enumerate(pages):
        left = top = 0.0
        for line in page.split("\n"):
            if line.endswith(" cm") and line.startswith("q "):
                left, top = map(float, line.split()[5:7])
            if line.startswith("BT"):
                bold, size, x, y, words = re.findall(
                    r"/F(\d) (\S+) Tf 1 0 0 -1 (\S+) (\S+) Tm \((.*)\)", line
                )[0]
                width = sum(metrics[int(bold)][item] for item in words) / 2000.0 * float(size)
                result.append((words, left + float(x) + width, number * 297.0 + top + float(y)))
    expected = []
    for group in ET.parse(out / "labels.svg").getroot().iter(f"{SVG}g"):
        left, top = map(float, re.findall(r"[\d.]+", group.attrib["transform"]))
        expected += [
            (str(item.text), left + float(item.attrib["x"]), top + float(item.attrib["y"]))
            for item in group.iter(f"{SVG}text")
        ]
    assert [item[0] for item in result] == [item[0] for item in expected]
    places = [np.array([item[1:] for item in some]) for some in (result, expected)]
    assert np.abs(places[0] - places[1]).max() < 0.01


def test_labels_of_small_panels_between_many_are_made_smaller_not_left_out() -> None:
    """Twelve neighbours with long ids round one panel."""
    turn = np.linspace(0.0, 2.0 * np.pi, 13)[:-1]
    ring = np.round(300.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1), 3).tolist()
    beyond = [f"AA{k:03d}" for k in range(12)]
    panel = {"id": "AB001", "outline_mm": ring, "neighbours": beyond}
    sheet = labels.label_sheets({"name": "many", "panels": [panel]})
    assert all(f">{name}<" in sheet for name in beyond)
