"""Coordinated tracks of KUKA arms: the tool pose by the text alone, and faults of programs."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import planner
from planner.catalogue.robots import urdf_path
from planner.geometry.arrays import FloatArray
from planner.proof.prove import Prover
from tests import following_job, track_job
from tests.languages.krl.rules.test_krl_external_axes import broken, changed, first, refused
from tests.proof.provers import prover_of

SLIN = re.compile(r"(SLIN \{[^\n]*?)(,E1 )(-?[0-9.]+)(\}[^\n]*)")
"""A straight move with the value of the track."""
NUMBER = r"(-?[0-9.]+)"
TARGET_POSE = re.compile(
    rf"SLIN \{{X {NUMBER},Y {NUMBER},Z {NUMBER},A {NUMBER},B {NUMBER},C {NUMBER},E1 {NUMBER}"
)


@pytest.fixture(scope="module")
def prover() -> Prover:
    return prover_of(following_job.planned_krl_job())


def test_a_row_longer_than_the_arm_reaches_is_one_proven_operation() -> None:
    out = following_job.planned_krl_job()
    assert out.verified, [str(issue) for issue in out.issues]
    values = out.plan.operations[0].targets.track_positions["left"]
    assert np.ptp(values) > 2.5 and values.min() >= -1.5 and values.max() <= 1.5
    text = "".join(out.programs.values())
    assert text.count("$VEL_EXTAX[1]=100") == 2 and text.count("$VEL_EXTAX[1]=25") == 3


def test_joints_have_the_tool_within_a_micrometre_where_the_text_wants_it_from_its_e1() -> None:
    """The arm by its stated axes and scipy's turns, on a foot that E1 of the text has moved along y."""
    out = following_job.planned_krl_job()
    arm = out.problem.cell.arm("left")
    for number, made in enumerate(out.plan.operations, start=1):
        (text,) = [t for file, t in out.programs.items() if file.endswith(f"row_{number}.src")]
        table = np.array([[float(v) for v in found] for found in TARGET_POSE.findall(text)])
        foot = Rotation.from_euler("z", 30, degrees=True)
        world = foot.apply(Rotation.from_euler("z", -30, degrees=True).apply(1e-3 * table[:, :3]))
        turn = Rotation.from_euler("ZYX", table[:, 3:6], degrees=True)
        q = made.q["left"][1:]
        assert len(q) == len(table) > 9
        place, own = chain("kr16_2", q)
        place, own = place + own.apply(arm.tool.tcp[:3, 3]), own * Rotation.from_matrix(arm.tool.tcp[:3, :3])
        seen = foot.apply(place) + 1e-3 * table[:, 6:] * [0.0, 1.0, 0.0]
        assert np.abs(seen - world).max() < 1e-6
        assert ((foot * own).inv() * turn).magnitude().max() < 1e-6
        np.testing.assert_allclose(1e-3 * table[:, 6], made.targets.track_positions["left"][1:], atol=1e-9)


def chain(name: str, q: FloatArray) -> tuple[FloatArray, Rotation]:
    """Places (N, 3) [m] and turns (N) of an arm's flange for its joints (N, 6) [rad], joint by joint of its
    URDF by scipy's turns."""
    place, turn = np.zeros((len(q), 3)), Rotation.from_quat(np.tile([0.0, 0.0, 0.0, 1.0], (len(q), 1)))
    turned = iter(q.T)
    for joint in ET.parse(urdf_path(name)).getroot().iter("joint"):
        origin, axis = joint.find("origin"), joint.find("axis")
        assert origin is not None
        place = place + turn.apply(np.array(origin.attrib["xyz"].split(), dtype=float))
        turn = turn * Rotation.from_euler("xyz", [float(v) for v in origin.attrib["rpy"].split()])
        if axis is not None:
            about = np.array(axis.attrib["xyz"].split(), dtype=float)
            turn = turn * Rotation.from_rotvec(next(turned)[:, None] * about)
    return place, turn


def moved(text: str, change: Callable[[int, float], float | str]) -> str:
    """Change the track values in straight moves, by their number and current value [mm].

    Retreats start where the last moves end.
    """
    number = iter(range(10**6))

    def replace(match: re.Match[str]) -> str:
        value = change(next(number), float(match[3]))
        told = value if isinstance(value, str) else f",E1 {value:.4f}"
        return f"{match[1]}{told}{match[4]}"

    text = SLIN.sub(replace, text)
    for part in (1, 2):
        last = re.findall(r",E1 (-?[0-9.]+)\}", text.split(f"DEF row_{part}()")[1].split("END\n")[0])[-1:]
        text = at(f"x_{part}_exit_1", float(last[0]))(text) if last else text
    return text


def at(name: str, value: float) -> Callable[[str], str]:
    """Another value [mm] of the track in data of joints or poses."""
    return lambda text: changed(text, rf"({name}=\{{[^}}]*,E1 )-?[\d.]+", rf"\g<1>{value:.4f}")


MUTANTS: dict[str, tuple[str, Callable[[str], str]]] = {
    "one target off": ("track_along", lambda t: moved(t, lambda k, v: v + 30.0 * (k == 30))),
    "one target far off": ("track_along", lambda t: moved(t, lambda k, v: v + 80.0 * (k == 30))),
    "it stands": ("status", lambda t: moved(t, lambda k, v: -600.0).replace("-1500.0", "-600.0")),
    "it stands where it began": ("track_along", lambda t: moved(t, lambda k, v: -1500.0 if k < 45 else v)),
    "it jumps": (
        "track_along",
        lambda t: moved(t, lambda k, v: min(v + 500.0, 1500.0) if 30 <= k < 60 else v),
    ),
    "it shakes": ("track_along", lambda t: moved(t, lambda k, v: v + 12.0 * (k % 2) * (v < 1350.0))),
    "it goes half as far": ("track_along", lambda t: moved(t, lambda k, v: 0.5 * (v - 1500.0))),
    "it goes back": ("track_along", lambda t: moved(t, lambda k, v: -v)),
    "beyond its range": ("external_axes", lambda t: moved(t, lambda k, v: v + 200.0)),
    "in metres": ("track_along", lambda t: moved(t, lambda k, v: 1e-3 * v)),
    "another axis": ("external_axes", lambda t: moved(t, lambda k, v: f",E2 {v:.4f}" if k == 20 else v)),
    "a second axis": (
        "external_axes",
        lambda t: moved(t, lambda k, v: f",E1 {v:.4f},E2 1.0" if k == 20 else v),
    ),
    "no value": ("external_axes", lambda t: moved(t, lambda k, v: "" if k == 20 else v)),
    "no value in any": ("syntax", lambda t: moved(t, lambda k, v: "")),
    "another value on the way out": ("syntax", at("x_1_exit_1", 900.0)),
    "another value at the start": ("syntax", at("p_1_start", -1400.0)),
    "another station": ("syntax", at("x_2_station_1", -317.4370)),
    "slower than it has to go": ("track_along", lambda t: first(t, "$VEL_EXTAX[1]=100", "$VEL_EXTAX[1]=10")),
    "not let go along": ("track_along", lambda t: changed(t, r"\$VEL_EXTAX\[1\]=100\n", "$VEL_EXTAX[1]=5\n")),
    "fast to the next station": (
        "external_axes",
        lambda t: changed(t, r"(row_1\(\)\n)\$VEL_EXTAX\[1\]=25\n", r"\1"),
    ),
    "fast home": ("external_axes", lambda t: changed(t, r"(row_2\(\)\n)\$VEL_EXTAX\[1\]=25\n", r"\1")),
    "of another controller variable": ("syntax", lambda t: first(t, "$VEL_EXTAX[1]=100", "$VEL_AXIS[7]=100")),
    "a kinematic of its own": ("syntax", lambda t: first(t, "$BASE=b_world", "BAS(#EX_BASE,1)")),
    "another frame": ("work_object", lambda t: changed(t, r"(b_world=\{X )0\.", r"\g<1>2.")),
    "another foot": ("base_frames", lambda t: changed(t, r"(base_frame=\{X )0\.", r"\g<1>2.")),
    "the direction of another track": (
        "syntax",
        lambda t: changed(t, r"ABS\(\$ROBROOT_C\.Y-0\.866025", "ABS($ROBROOT_C.Y+0.866025"),
    ),
    "no look at where the track has taken it": (
        "syntax",
        lambda t: changed(t, r"(?s)(PTP x_2_station_1\n).*?(\$VEL_AXIS)", r"\1\2"),
    ),
    "told another value": ("dialogue", lambda t: first(t, "to -316.437", "to 316.437")),
    "not told that it goes along": (
        "setup",
        lambda t: t.replace(", and goes along while the arm works.", "."),
    ),
    "not home at the end": ("external_axes", lambda t: re.sub(r"(?s)(.*)PTP x_home\n", r"\1", t)),
}


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize("name", MUTANTS)
def test_a_track_that_goes_along_otherwise_is_refused(prover: Prover, name: str) -> None:
    word, change = MUTANTS[name]
    refused(prover, broken(following_job.planned_krl_job().programs, change), word)


def test_spline_blocks_are_refused_where_the_track_goes_along(tmp_path: Path) -> None:
    made = following_job.problem(
        tmp_path, count=5, depth=1000.0, controller={"path": "spline"}, **track_job.KUKA
    )
    (issue,) = [i for i in planner.check(made) if i.severity == "error"]
    assert issue.code == "post.path" and "on a coordinated track" in issue.message


@pytest.mark.long
def test_the_older_dialect_has_a_track_that_goes_along_as_well() -> None:
    out = following_job.planned_krl_job(dialect="krc2")
    assert out.verified
    (moves,) = [text for file, text in out.programs.items() if file.endswith("row_1.src")]
    assert len(set(re.findall(r"LIN \{[^}]*,E1 (-?[\d.]+)\}", moves))) > 30
