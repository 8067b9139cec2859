"""Sections of a face: their positions, and the strip of the face that each one represents."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from planner.processes.hotwire.plan.elastic.family import (
    SectionSet,
    Spine,
    section_positions,
    sweep_direction,
)


def test_the_plane_at_the_place_of_a_point_passes_it() -> None:
    """Upright planes, and planes that lean with the spine's height."""
    height = BSpline(np.r_[[-0.2] * 4, 0.0, [0.2] * 4], np.array([0.0, 0.02, 0.06, 0.05, 0.01]), 3)
    points = np.random.default_rng(7).uniform(-1.0, 1.0, (50, 3)) * [0.3, 0.3, 0.06]
    upright = Spine(sweep_direction(30.0), 0.01)
    for spine in (upright, Spine(sweep_direction(30.0), 0.01, height, -0.2, 0.2)):
        frames = spine.frames(spine.positions(points))
        deviation = np.einsum("vd,vd->v", points - frames[:, :3, 3], frames[:, :3, 2])
        assert np.abs(deviation).max() < 1e-6


def test_sections_stand_closer_towards_both_ends_and_nowhere_farther_than_the_step() -> None:
    p = section_positions(-0.25, 0.35, 0.006, 40, 140)
    gaps = np.diff(p)
    assert -0.25 < p[0] < -0.2496
    assert 0.3496 < p[-1] < 0.35
    assert (gaps > 0.0).all()
    assert gaps.max() < 0.006 + 1e-12
    np.testing.assert_allclose(p + p[::-1], 0.1, atol=1e-12)


def test_what_a_share_of_a_face_is_within_goes_by_its_area() -> None:
    """However many sections are off at an end, they count by what they cover."""
    even = np.linspace(0.0, 0.9, 91)
    p = np.concatenate([even, np.linspace(0.901, 1.0, 100)])
    off = np.where(p > 0.9, 3e-3, 1e-4)[:, None] * np.ones(41)
    sections = SectionSet(p, np.zeros((191, 41, 2)), np.full(191, 0.2), np.ones(191, dtype=np.int64))
    assert sections.distance_at_fraction(off, 0.89) == 1e-4
    assert sections.distance_at_fraction(off, 0.91) == 3e-3
    short = np.where(p > 0.9, 0.02, 0.2)  # a hundredth of the face
    assert (
        SectionSet(p, sections.points, short, sections.polyline_count).distance_at_fraction(off, 0.98) == 1e-4
    )
