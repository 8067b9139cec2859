"""The kerf of a bent wire is wider where the wire is slower, and the wire stays half of it off the face."""

from __future__ import annotations

import re

import numpy as np
import pytest

from planner.catalogue.materials import foam
from planner.issues import TandemError
from planner.processes.hotwire.claims import CutsSurface, KerfWithin
from planner.processes.hotwire.plan.elastic import job as elastic_job
from planner.processes.hotwire.plan.kerf.width import HotWire, curve
from planner.processes.hotwire.proof.cut_surface import WireSweep, distance_to_sweep, sample_face
from planner.targets import FEED_FRACTION
from tests.processes.hotwire.plan import panels

FOAM = foam("eps_a120")
POWER, FEED, SLOPE = 90.0, 0.004, 0.3
ROUND = {"material": "spring_steel", "diameter_mm": 0.8, "length_mm": 520, "temperature_c": 300}
FLAT = ((-70.0, 0.0), (-25.0, 8.0), (25.0, 8.0), (70.0, 0.0))


def twisted() -> dict:
    """An arch whose one end sinks and whose other end rises along y: by SLOPE mm a mm at x = -70 and 70."""
    half = 100.0
    sections = []
    for at, y in ((0.0, -half), (0.5, 0.0), (1.0, half)):
        points = [[x, y, z + SLOPE * y * x / 70.0] for x, z in FLAT]
        sections.append({"at": at, "bezier_mm": points})
    return {"loft": {"sections": sections, "flip": True, "chord_mm": 0.01}}


def operation(**more):
    heat = {"kerf_mm": None, "power_w": POWER, "kerf_range_mm": (0.3, 6.0)}
    return panels.operation(ROUND, **{"faces": ("front",), "sweep": "y", "feed_mm_s": 4, **heat, **more})


def test_the_wire_keeps_half_of_the_local_kerf_off_the_face() -> None:
    """Closed form: a wire in upright planes moves by (0, 1, g) a unit of sweep, g = SLOPE x / 70 mm; across
    itself that is sqrt(1 + g^2 cos^2 a), a being the angle of its tangent to the level."""
    block = panels.stock(size=(0.16, 0.23, 0.2))
    block = type(block)(**{**vars(block), "foam": FOAM})
    setup = panels.setup(block)
    part = panels.part(twisted(), None, block)
    targets = elastic_job.ElasticJob(operation(), setup, part).targets()
    claim = next(c for c in targets.claims if isinstance(c, CutsSurface))
    assert any(isinstance(c, KerfWithin) for c in targets.claims)
    known = curve(FOAM, HotWire(0.0008, 0.52), POWER, 0.16, np.array([0.001, 0.05]))
    np.testing.assert_allclose(claim.kerf.at(np.array([0.005])), known.at(np.array([0.005])), atol=2e-6)
    points, normals, _ = sample_face(claim.vertices, claim.faces)
    rows = targets.flexible_tool.points[[str(s) == "cut/front" for s in targets.segment]]
    away, _ = distance_to_sweep(points, normals, WireSweep.continuous(rows))
    tilt = np.arctan2(-normals[:, 0], normals[:, 2])
    rate = np.sqrt(1.0 + (SLOPE * points[:, 0] / 0.070) ** 2 * np.cos(tilt) ** 2)
    middle = np.abs(points[:, 1]) < 0.08
    # the fastest point in the foam sets the feed: at the ends of the arch or where the wire leaves the block
    fraction = rate / rate[middle].max()
    expected = 0.5 * claim.kerf.at(FEED_FRACTION * FEED * fraction)  # clocks go at that share of a feed
    assert np.ptp(expected[middle]) > 5e-5  # the kerf does vary
    got = away[middle & np.isfinite(away)]
    expected_value = expected[middle & np.isfinite(away)]
    assert np.quantile(np.abs(got - expected_value), 0.95) < 6e-5
    assert np.corrcoef(got, expected_value)[0, 1] > 0.8


def test_a_clock_that_is_slower_than_the_feed_is_refused_with_the_feed_that_the_arms_hold() -> None:
    """The slot that the arms melt follows from the foam's own curve, at a third of the speed on a part of the
    way; a clock that keeps the feed is fine."""
    block = panels.stock(size=(0.16, 0.23, 0.2))
    block = type(block)(**{**vars(block), "foam": FOAM})
    own = operation(feed_min_mm_s=0.5)
    job = elastic_job.ElasticJob(own, panels.setup(block), panels.part(twisted(), None, block))
    targets = job.targets()
    even = targets.travel / (FEED_FRACTION * targets.feed)
    assert job.check_timing(targets, np.cumsum(even)) == ()
    y = targets.flexible_tool.points[:, :, 1].mean(axis=1)
    cut = np.array([str(s) == "cut/front" for s in targets.segment])
    slow = np.cumsum(np.where(cut & (np.abs(y) < 0.05), 3.0, 1.0) * even)
    (issue,) = job.check_timing(targets, slow)
    assert issue.code == "kerf.too_hot"
    held = float(re.findall(r"feed_mm_s: ([\d.]+),", str(issue.hint))[0])
    assert 0.95 * 4.0 / 3.0 < held < 4.0 / 3.0
    known = curve(FOAM, HotWire(0.0008, 0.52), POWER, 0.16, np.array([0.0005, 0.05]))
    # no point in the foam is faster than the feed
    assert issue.value >= 1e3 * float(known.at(np.array([FEED_FRACTION * FEED / 3.0]))[0]) - 1e-3
    assert "at 33 % of its feed" in issue.message


def test_a_power_needs_the_blocks_foam_and_a_round_wire() -> None:
    with pytest.raises(TandemError) as caught:
        elastic_job.ElasticJob(operation(), panels.setup(), panels.part()).claims()
    assert [i.code for i in caught.value.issues] == ["stock.foam_missing"]
    strip = {"material": "spring_steel", "width_mm": 5, "thickness_mm": 0.5, "length_mm": 520}
    with pytest.raises(ValueError, match="strips"):
        panels.operation({**strip, "temperature_c": 300}, kerf_mm=None, power_w=40)


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize(("power", "code"), [(90.0, "kerf.too_hot"), (20.0, "kerf.too_cold")])
@pytest.mark.parametrize("remedy", ["power_w", "feed_mm_s"])
def test_slots_out_of_their_range_are_refused_before_motion_with_what_does(
    power: float, code: str, remedy: str
) -> None:
    block = panels.stock(size=(0.16, 0.23, 0.2))
    setup = panels.setup(type(block)(**{**vars(block), "foam": FOAM}))
    part = panels.part(twisted(), None, block)
    own = {"power_w": power, "kerf_range_mm": (1.0, 3.0), "feed_min_mm_s": 0.2}
    with pytest.raises(TandemError) as caught:
        elastic_job.ElasticJob(operation(**own), setup, part).targets()
    (issue,) = caught.value.issues
    assert issue.code == code
    slow = curve(FOAM, HotWire(0.0008, 0.52), power, 0.16, np.array([0.001, 0.05]))
    speed = float(re.search(r"at (\d+\.\d+) mm/s at", issue.message)[1])
    assert issue.value == pytest.approx(float(slow.at(np.array(speed * 1e-3))) * 1e3, rel=0.01)
    value = float(re.search(rf"{remedy}: (\d+(?:\.\d+)?)", issue.hint)[1])
    targets = elastic_job.ElasticJob(operation(**own | {remedy: value}), setup, part).targets()
    assert targets.count > 2
