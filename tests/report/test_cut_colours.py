"""Figures of the proof along the cut: the worst before each keyframe, and none where none is known."""

from __future__ import annotations

import dataclasses

import numpy as np

from planner.report import cut_colour_layers
from tests.report import synthetic_job as job

TIME = np.array([0.0, 1.0, 2.0, 3.0])


def test_a_dip_between_two_keyframes_is_seen_at_the_second() -> None:
    at, value = np.array([0.0, 1.4, 1.5, 1.6, 3.0]), np.array([9.0, 9.0, 2.0, 9.0, 12.0])
    minimum = cut_colour_layers.interval_extremes(at, value, TIME, use_min=True)
    np.testing.assert_allclose(minimum, [9.0, 9.0, 2.0, 9.0 + 3.0 * 0.4 / 1.4])
    maximum = cut_colour_layers.interval_extremes(at, value, TIME, use_min=False)
    np.testing.assert_allclose(maximum, [9.0, 9.0, 9.0 + 3.0 * 0.4 / 1.4, 12.0])


def test_outside_of_a_curve_and_in_its_gaps_there_is_nothing() -> None:
    at, value = np.array([0.5, 1.2, 1.3, 2.4, 2.5, 2.8]), np.array([5.0, 5.0, np.nan, np.nan, 7.0, 7.0])
    result = cut_colour_layers.interval_extremes(
        at, value, np.array([0.0, 0.4, 1.0, 1.4, 2.2, 2.6, 4.0]), use_min=False
    )
    np.testing.assert_allclose(result, [np.nan, np.nan, 5.0, 5.0, np.nan, 7.0, 7.0])
    assert np.isnan(cut_colour_layers.interval_extremes(at, np.full(6, np.nan), TIME, use_min=True)).all()


def test_between_two_cuts_no_speed_is_told_and_its_colour_is_grey() -> None:
    proof = job.proof()
    (wire,) = {name.rpartition("/")[0] for name in proof.series if name.endswith("/feed")}
    label = [str(item) for item in proof.series[f"{wire}/label"]]
    time = np.asarray(proof.series[f"{wire}/time"])
    keys = np.linspace(time[0] - 3.0, time[-1] + 3.0, 60)
    layers = cut_colour_layers.colour_layers(job.problem(), job.plan(), proof, keys)
    speed = next(layer for layer in layers if layer.name == "speed")
    outside = (keys < time[0]) | (np.concatenate([keys[:1], keys[:-1]]) > time[-1])
    assert len(label) and np.isnan(speed.values[""][outside]).all() and outside.sum() >= 2
    grey = np.ptp(speed.colours[""][outside], axis=1)
    assert (grey < 0.1).all()
    assert np.nanmax(speed.values[""]) <= 1000.0 * np.nanmax(proof.series[f"{wire}/feed"]) + 1e-9


def test_without_a_proof_there_are_no_colours() -> None:
    assert cut_colour_layers.colour_layers(job.problem(), job.plan(), None, TIME) == ()
    bare = dataclasses.replace(job.proof(), series={}, surfaces=())
    assert cut_colour_layers.colour_layers(job.problem(), job.plan(), bare, TIME) == ()
