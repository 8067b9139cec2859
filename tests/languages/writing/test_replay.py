"""Programs as the proof's own reader and replay take them: the motion in the text is the planned one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner.programs import job
from planner.proof.replay import playback
from planner.proof.setups import setup_spans
from planner.targets import TargetAction
from tests.languages.writing import synthetic
from tests.languages.writing.reading import programs


def read(plan, problem):
    """The programs as read; without faults."""
    text = job.read_job(problem, programs(plan, problem))
    assert not text.faults and not text.flow_faults and not text.strays
    assert text.stages
    return text


@pytest.mark.parametrize("model", ["irb140", "irb4600_40", "irb4400_60"])
def test_the_text_alone_leads_back_to_the_planned_joints(model):
    plan, problem = synthetic.small(model=model)
    motion = playback.replay(read(plan, problem), plan.bases)
    assert not motion.faults
    inside = motion.node_ids > 0
    for arm, q in plan.operations[0].q.items():
        assert np.abs(motion.q[arm][motion.node_sample[inside]][-1] - q[-1]).max() < 1e-6
        if model != "irb4400_60":  # how a parallel-rod arm counts cfx is not settled
            assert np.abs(motion.node_conf_q[arm][inside] - q[1:]).max() < 1e-6
            assert motion.node_conf_ok[arm].all()
    durations = motion.node_duration[inside]
    assert durations == pytest.approx(np.diff(plan.operations[0].time))
    cut = np.char.startswith(motion.labels(), "cut")
    assert cut.any()


def test_a_program_ends_where_it_began():
    plan, problem = synthetic.small()
    motion = playback.replay(read(plan, problem), plan.bases)
    for arm in ("left", "right"):
        assert np.abs(motion.q[arm][0] - synthetic.HOME).max() < 1e-9
        assert np.abs(motion.q[arm][-1] - synthetic.HOME).max() < 1e-7


KINDS = st.sampled_from(["approach", "cut/front", "link", "cut/back", "retreat"])
SEGMENTS = st.lists(st.tuples(KINDS, st.integers(1, 6), st.booleans()), min_size=1, max_size=6)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(SEGMENTS, st.booleans(), st.integers(0, 3), st.booleans())
def test_any_row_of_segments_reads_back_with_pairs_and_points_in_order(segments, together, repeats, twice):
    labels, stops, actions = ["mount"], [], [TargetAction(0, "on", signal="doWirePower")]
    for label, count, stop in segments:
        labels += [label] * count
        if stop:
            stops.append(len(labels) - 1)
            actions.append(TargetAction(len(labels) - 1, "confirm", text=label))
    arms = ("left", "right") if together else ("right",)
    problem = synthetic.problem()
    q = {arm: synthetic.sweep(len(labels), size) for arm, size in zip(arms, (0.3, 0.2), strict=False)}
    for joints in q.values():
        joints[1 : 1 + min(repeats, len(labels) - 1)] = joints[0]  # neither arm moves at first
    operation = synthetic.operation(problem, q, labels, stop=stops, actions=actions, coupled=together)
    plan = synthetic.plan(*[operation] * (1 + twice))
    text = read(plan, problem)
    assert len(text.tasks) == len(arms)
    moved = 0
    for stage in text.stages:
        rows = [stage.moves(task.name) for task in text.tasks]
        if stage.synchronised:
            assert len({tuple(move.id for move in row) for row in rows}) == 1
            assert len({tuple(move.time for move in row) for row in rows}) == 1
            assert rows[0][-1].zone.fine
        else:
            assert sum(bool(row) for row in rows) <= 1
        moved += sum(move.kind == "MoveL" for move in rows[0])
    assert moved == (1 + twice) * (len(labels) - 1 - min(repeats, len(labels) - 1))


@pytest.mark.parametrize(
    "build_job", [synthetic.two_setups, synthetic.held, lambda: synthetic.held(released=True)]
)
def test_setups_and_held_blocks_lead_back_to_the_planned_joints(build_job):
    plan, problem = build_job()
    text = read(plan, problem)
    of_stage = setup_spans(problem.setups, text).of_stage
    assert sorted(set(of_stage.tolist())) == list(range(len(problem.setups)))
    mounted = [{arm.name: arm.tool.tcp for arm in setup.cell.arms} for setup in problem.setups]
    motion = playback.replay(text, plan.bases, [mounted[i] for i in of_stage])
    assert not motion.faults
    reached = {arm: np.concatenate([motion.node_conf_q[arm], motion.q[arm]]) for arm in motion.q}
    for operation in plan.operations:
        for arm, q in operation.q.items():
            for expected in q:
                assert np.nanmin(np.abs(reached[arm] - expected).max(axis=1)) < 1e-6
