"""Saved plans: complete and exact round trip, equal bytes for equal plans, and refusal of damaged files."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import pipeline, plans
from planner.claims import claim
from planner.claims.segments import Segment
from planner.issues import Issue, Severity, TandemError
from planner.plans import OperationPlan, Plan
from planner.processes import registry
from planner.processes.hotwire import claims
from planner.processes.poses import claims as poses_claims
from planner.targets import FlexibleTool, ScrewFreedom, TableFreedom, TargetAction, Targets
from tests.proof.planner_jobs import JOBS

RNG = np.random.default_rng(3)


def _targets(exhibits: dict[str, Any] | None = None) -> Targets:
    n, k = 4, 3
    spin = ScrewFreedom(
        "spin",
        {"left": np.array([1.0, 0, 0, 0, 0, 0]), "right": np.array([1.0, 0, 0, 0, 0, 0])},
        np.full(n, -np.inf),
        np.full(n, np.inf),
        periodic=True,
    )
    split = TableFreedom(
        "slack split",
        np.linspace(-0.01, 0.01, k),
        {"left": RNG.normal(size=(n, k, 4, 4)), "right": RNG.normal(size=(n, k, 4, 4))},
        np.full(n, -0.01),
        np.full(n, 0.01),
        prefer=np.zeros(n),
    )
    held = (
        claims.WireJoins(("left", "right"), 0.9, 1e-3, 2e-3, 1e-3, 0.01, True, 30.0, 1e-3, 1e-4),
        claims.CutsSurface(
            Segment.read("cut/front"),
            RNG.normal(size=(3, 3)),
            np.array([[0, 1, 2]]),
            claims.KerfCurve.constant(1e-3),
            5e-4,
        ),
        claim.ContactOnlyIn(("cut",), "doWirePower", 2.0),
        claim.FeedWindow(Segment.read("cut/front"), 0.002, 0.01),
        poses_claims.FollowsPoses("left", "stock", RNG.normal(size=(2, 4, 4)), (np.eye(6)[0],), 1e-4, 1e-3),
    )
    return Targets(
        arms=("left", "right"),
        pose={arm: RNG.normal(size=(n, 4, 4)) for arm in ("left", "right")},
        frame={"left": "stock", "right": "held:left"},
        freedoms=(spin, split),
        feed=np.full(n, 0.01),
        feed_min=np.zeros(n),
        travel=RNG.random(n),
        stop=np.array([True, False, False, True]),
        segment=tuple(map(Segment.read, ("mount", "cut/front", "cut/front_in", "unmount"))),
        coupled=True,
        flexible_tool=FlexibleTool(RNG.normal(size=(n, 5, 3)), 1e-3),
        actions=(
            TargetAction(0, "confirm", "Mount the wire – 870,0 mm"),
            TargetAction(0, "wait", seconds=2.5),
        ),
        claims=held,
        exhibits={"wire": {"kind": "table", "rows": [("length", 0.9), ["mixed", None, True]]}}
        if exhibits is None
        else exhibits,
        issues=(Issue("internal.error", "made up", Severity.NOTE, bodies=("a", "b"), value=1.0, count=3),),
    )


def some_plan(exhibits: dict[str, Any] | None = None, metrics: dict[str, Any] | None = None) -> Plan:
    targets = _targets(exhibits)
    n = targets.count
    operation = OperationPlan(
        name="faces",
        targets=targets,
        q={arm: RNG.normal(size=(n, 6)) for arm in targets.arms},
        values=RNG.normal(size=(n, 2)),
        time=np.cumsum(RNG.random(n)),
        approach={arm: RNG.normal(size=(2, 6)) for arm in targets.arms},
        retreat={arm: np.zeros((0, 6)) for arm in targets.arms},
        arm_order=("right", "left"),
        metrics={"cost": np.float64(1.25), "closest": {"a/b": np.array([1, 2]), "a": {"b": np.float32(2)}}},
    )
    return Plan(
        "made up",
        "00ff",
        {"planner": "0.1.0"},
        (RNG.normal(size=(4, 4)),),
        {"left": np.eye(4), "right": -np.eye(4)},
        (operation,),
        metrics if metrics is not None else {"nan": float("nan"), "inf": -np.inf, 3: "three", "$odd": "key"},
    )


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray):
        return (
            isinstance(b, np.ndarray)
            and a.dtype == b.dtype
            and a.shape == b.shape
            and a.tobytes() == b.tobytes()
        )
    if isinstance(a, float | np.floating):
        return bool(a == b) or (np.isnan(a) and np.isnan(b))
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(
            _equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a)
        )
    if isinstance(a, dict):
        return isinstance(b, dict) and list(a) == list(b) and all(_equal(a[k], b[k]) for k in a)
    if isinstance(a, tuple | list):
        return type(a) is type(b) and len(a) == len(b) and all(map(_equal, a, b))
    return type(a) is type(b) and bool(a == b)


def test_every_value_comes_back_exactly(tmp_path: Path) -> None:
    plan = some_plan()
    plans.save(plan, tmp_path / "out")
    assert _equal(plan, plans.load(tmp_path / "out"))


@pytest.mark.parametrize(
    "name",
    [
        "posed_two",
        "elastic",
        "plate",
        "held",
        "dpif_p",
        "adsif",
        "tpif",
        "flank",
        "lines",
        "engrave",
        "gcode",
    ],
)
def test_claims_of_every_process_come_back(tmp_path: Path, name: str) -> None:
    """Those of small jobs of all kinds; files come back as their names."""
    (own,) = registry.claims(pipeline.load(JOBS[name](tmp_path))).values()
    plan = some_plan()
    (operation,) = plan.operations
    operation = dataclasses.replace(operation, targets=dataclasses.replace(operation.targets, claims=own))
    plans.save(dataclasses.replace(plan, operations=(operation,)), tmp_path / "out")
    back = plans.load(tmp_path / "out").operations[0].targets.claims
    assert _equal(_replace_files(own), back)


def _replace_files(value: Any) -> Any:
    """The value with its files as their names."""
    if isinstance(value, Path):
        return Path(value.name)
    if isinstance(value, tuple):
        return tuple(map(_replace_files, value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type | Segment):
        fields = {f.name: _replace_files(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return dataclasses.replace(value, **fields)
    return value


def test_equal_plans_give_equal_bytes_and_leave_nothing_else(tmp_path: Path) -> None:
    plan = some_plan()
    for folder in ("a", "b"):
        plans.save(plan, tmp_path / folder)
    for name in ("plan.npz", "plan.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["plan.json", "plan.npz"]


def test_arrays_have_path_like_keys_and_no_pickles(tmp_path: Path) -> None:
    plans.save(some_plan(), tmp_path)
    with np.load(tmp_path / "plan.npz", allow_pickle=False) as archive:
        assert {
            "operations/0/q/left",
            "operations/0/targets/flexible_tool/points",
            "operations/0/metrics/closest/a~1b",
        } <= set(archive.files)
        for key in archive.files:
            assert archive[key].dtype != object


def test_what_cannot_be_saved_is_named_and_nothing_is_written(tmp_path: Path) -> None:
    for bad in (object(), np.array([None, 1], dtype=object), {1, 2}):
        with pytest.raises(TandemError) as caught:
            plans.save(some_plan(exhibits={"picture": {"data": bad}}), tmp_path / "out")
        (issue,) = caught.value.issues
        assert issue.code == "plan.not_saveable"
        assert issue.field == "operations/0/targets/exhibits/picture/data"
    assert not (tmp_path / "out").exists()


def _code(folder: Path) -> str:
    with pytest.raises(TandemError) as caught:
        plans.load(folder)
    return caught.value.issues[0].code


def test_missing_files_are_named(tmp_path: Path) -> None:
    assert _code(tmp_path) == "plan.missing_file"
    plans.save(some_plan(), tmp_path)
    (tmp_path / "plan.npz").unlink()
    assert _code(tmp_path) == "plan.missing_file"


@pytest.mark.parametrize("content", [b"{", b"\xff\xfe", b"[" * 100_000])
def test_json_that_is_none_is_damaged(tmp_path: Path, content: bytes) -> None:
    plans.save(some_plan(), tmp_path)
    (tmp_path / "plan.json").write_bytes(content)
    assert _code(tmp_path) == "plan.damaged"


def test_a_pair_of_two_plans_is_damaged(tmp_path: Path) -> None:
    plans.save(some_plan(), tmp_path / "a")
    plans.save(some_plan(), tmp_path / "b")
    (tmp_path / "a" / "plan.npz").write_bytes((tmp_path / "b" / "plan.npz").read_bytes())
    assert _code(tmp_path / "a") == "plan.damaged"


@pytest.mark.parametrize("edit", ["type", "field", "array", "missing", "whole"])
def test_wrong_content_is_damaged(tmp_path: Path, edit: str) -> None:
    plans.save(some_plan(), tmp_path)
    path = tmp_path / "plan.json"
    data = json.loads(path.read_text())
    plan = data["plan"]
    if edit == "type":
        plan["$type"] = "os.system"
    elif edit == "field":
        plan["surplus"] = 1
    elif edit == "array":
        plan["stock_poses"] = [{"$array": "/nowhere"}]
    elif edit == "missing":
        del plan["digest"]
    else:
        data["plan"] = {"a": 1}
    path.write_text(json.dumps(data))
    assert _code(tmp_path) == "plan.damaged"


@pytest.mark.parametrize("change", [{"schema": 99}, {"format": "something else"}])
def test_another_schema_or_format_is_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    plans.save(some_plan(), tmp_path)
    path = tmp_path / "plan.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    assert _code(tmp_path) == "plan.schema"
