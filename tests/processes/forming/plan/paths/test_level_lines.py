"""Spacing of loops by scallop height, against the closed form on a sphere."""

from __future__ import annotations

import numpy as np
import pytest

from planner.processes.forming.plan.contact import ContactPath
from planner.processes.forming.plan.paths.contact_path import make_contact_path
from planner.processes.forming.plan.paths.level_lines import constant_levels, scallop_height, scallop_spacing
from planner.processes.forming.plan.paths.spiral import PathOptions
from tests.processes.forming.plan.paths.path_faces import bowl

RADIUS, SCALLOP, SPHERE = 0.005, 2e-5, 0.06


def loop_levels(path: ContactPath) -> np.ndarray:
    return np.array([np.median(path.point[path.loop == k, 2]) for k in range(path.loop.max() + 1)])


def path_length(path: ContactPath) -> float:
    return float(np.linalg.norm(np.diff(path.centre, axis=0), axis=1).sum())


def test_width_is_the_published_one() -> None:
    # R = 5 mm, h = 0.01 mm on walls of 20, 45 and 65 degrees
    step = scallop_spacing(0.005, 1e-5) * np.sin(np.radians([20.0, 45.0, 65.0]))
    assert 1e3 * step == pytest.approx([0.216, 0.447, 0.573], abs=6e-4)
    assert scallop_height(0.005, scallop_spacing(0.005, 1e-5)) == pytest.approx(1e-5)


def test_constant_levels_end_at_the_end() -> None:
    assert constant_levels(0.0, -0.01, 0.004) == pytest.approx([-0.004, -0.008, -0.01])
    assert constant_levels(0.0, -0.008, 0.004) == pytest.approx([-0.004, -0.008])
    assert constant_levels(0.0, -0.008, 0.1) == pytest.approx([-0.008])


def test_ridges_hold_and_the_path_is_shorter_than_at_a_constant_step() -> None:
    deep = SPHERE * (1.0 - np.cos(np.radians(65.0)))
    flat = SPHERE * (1.0 - np.cos(np.radians(12.0)))
    one = bowl(SPHERE, deep, count=120, walls=80, end=flat - deep)  # walls from 65 down to 12 degrees
    options = PathOptions(stepdown=None, scallop=SCALLOP, chord=2e-4)
    path = make_contact_path(one, RADIUS, options)
    level = np.append(0.0, loop_levels(path))
    angle = np.arccos(1.0 - (level + deep) / SPHERE)
    width = -np.diff(level) / np.sin(np.minimum(angle[1:], angle[:-1]))  # the flattest of both lines
    predicted = scallop_height(RADIUS, width)
    assert predicted.max() <= 1.005 * SCALLOP  # facets of 0.8 degrees
    assert np.median(predicted) >= 0.75 * SCALLOP
    step = float(scallop_spacing(RADIUS, SCALLOP) * np.sin(np.radians(12.0)))
    even = make_contact_path(one, RADIUS, PathOptions(stepdown=step, chord=2e-4))
    assert path_length(path) <= 0.7 * path_length(even)
    assert path.loop.max() <= 0.7 * even.loop.max()


def test_lines_stay_apart_where_the_face_becomes_flat() -> None:
    one = bowl(SPHERE, 0.02, count=120, walls=120)
    path = make_contact_path(one, RADIUS, PathOptions(stepdown=None, scallop=SCALLOP, chord=2e-4))
    level = loop_levels(path)
    angle = np.arccos(np.clip(1.0 - (level + 0.02) / SPHERE, -1.0, 1.0))
    apart = SPHERE * -np.diff(angle)  # along the sphere
    width = scallop_spacing(RADIUS, SCALLOP)
    assert apart.max() <= 1.1 * width
    assert apart[:-1].min() >= 0.4 * width
    assert angle[-1] * SPHERE < width  # and the bottom is reached
