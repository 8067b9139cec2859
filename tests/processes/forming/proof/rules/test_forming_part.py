"""Claims on the passes of a sheet, against the part and the user's numbers.

The planner's own claims hold for many parts. Each fault that is put into the planner in memory is reported by
its rule.
"""

from __future__ import annotations

import dataclasses
import importlib

import numpy as np
import pytest

from planner import pipeline
from planner.claims.segments import Segment
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.processes import registry
from planner.processes.forming.claims import FormsPart
from planner.processes.forming.plan.features import tree
from planner.processes.forming.proof.formed_shapes import FormedShape
from planner.processes.forming.proof.forming_facts import FORMING, FormingFacts
from planner.processes.forming.proof.rules.claims import check_forming_claims
from planner.processes.forming.proof.rules.part import check_forming_part
from planner.proof.context import Context
from tests import small_forming
from tests.processes.forming.plan import nests, shapes
from tests.processes.forming.proof import forming_job

PART, CLAIMS = "verify.forming_part", "verify.forming_claims"
WIDE = {"size_mm": [240, 240], "opening_mm": 130}


def steep():
    """A dish of 75 degrees: two passes with a tool opposite."""
    return small_forming.dish(34.0, 9.0, 75.0, 6.0, 96)


def lopsided():
    """A dish with a dome on its floor, squeezed to an oval that is not like itself mirrored in any axis."""
    part = small_forming.dish_with_a_dome(96)
    x, y, z = part.vertices.T
    moved = np.column_stack([x + 0.1 * y + 1.5 * x * y, 0.85 * y, z])
    return dataclasses.replace(part, vertices=moved)


def problem(folder, mode="dsif", part=None, sheet=None, **operation):
    data = small_forming.problem(mode, **operation)
    data["sheet"] |= sheet or {}
    return pipeline.load(small_forming.write(folder, data, part))


def broken_codes(loaded, change=None):
    """Codes of both rules that the claims of a problem break; ``change`` makes other claims of them."""
    group = registry.claims(loaded)
    if change is not None:
        group = {name: change(one) for name, one in group.items()}
    context = Context(loaded, group, {})
    forming = FormingFacts.__new__(FormingFacts)  # of a text there is no need
    forming.context = context
    context.put(FORMING, forming)
    return {
        issue.code for rule in (check_forming_part, check_forming_claims) for issue in rule(context).issues
    }


PARTS = {
    "dish": ("spif", None, None, {}),
    "squeezed": ("dsif", None, None, {"squeeze": 0.9}),
    "up": ("dpif_l", lambda: small_forming.upside_down(small_forming.dish()), None, {"shift_deg": 20}),
    "border": ("dpif_p", None, None, {}),
    "second stage": ("dpif_p", small_forming.dish_with_a_dome, WIDE, {}),
    "in place": ("dsif", lopsided, WIDE, {}),
    "virgin": ("dsif", lopsided, WIDE, {"strategy": "virgin"}),
    "order of one's own": ("dsif", lopsided, WIDE, {"strategy": "virgin", "order": [2, 1]}),
    "heat": ("heat", None, None, {}),
    "steep": ("dsif", steep, None, {}),
    "passes of one's own": ("spif", steep, None, {"passes": [30.0, 55.0], "repeats": 2}),
    "ridges": ("spif", lambda: shapes.bowl(0.04, 40.0), None, {"stepdown_mm": None, "scallop_mm": 0.02}),
    "sharp": ("dsif", lambda: shapes.cone(45.0, 0.008, 0.03, 60), None, {}),
    "table": ("adsif", lambda: shapes.cone(25.0, 0.004, 0.02, 96), None, {}),
}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", PARTS)
def test_the_claims_of_a_part_hold(tmp_path, name):
    mode, part, sheet, options = PARTS[name]
    options = {key: value for key, value in options.items() if value is not None}
    assert broken_codes(problem(tmp_path, mode, part and part(), sheet, **options)) == set()


@pytest.mark.parametrize(("kind", "full"), [("female", True), ("male", False)])
def test_the_claims_over_a_die_hold(tmp_path, kind, full):
    part = small_forming.dish() if kind == "female" else small_forming.upside_down(small_forming.dish())
    found = problem(tmp_path, "tpif", part, die=small_forming.die(tmp_path, part, kind, full))
    assert broken_codes(found) == set()


def change_result(function):
    """Return a patch that applies ``function`` to the result of a callable."""
    return lambda old: lambda *args, **more: function(old(*args, **more))


def change_each(function):
    return change_result(lambda found: tuple(function(one) for one in found))


def move_faces(by):
    return change_each(
        lambda one: dataclasses.replace(
            one,
            vertices=one.vertices + np.array(by),
            start=one.start + by[2],
            end=one.end + by[2],
            region=one.region + np.array(by[:2]),
        )
    )


def mirror_faces(matrix):
    """Transform all faces by a mirroring matrix."""
    return change_each(
        lambda one: dataclasses.replace(
            one,
            vertices=one.vertices @ np.array(matrix, dtype=float).T,
            faces=one.faces[:, ::-1],
            region=one.region @ np.array(matrix, dtype=float)[:2, :2].T,
        )
    )


def gaps(function):
    def patch(old):
        def by_corner(forming_pass, thickness):
            vertices, faces, thick = old(forming_pass, thickness)
            return vertices, faces, function(thick, thickness)

        return by_corner

    return patch


PASSES = "planner.processes.forming.plan.process_plan.make_passes"
BY_CORNER = "planner.processes.forming.plan.claims.face_by_corner"
VIRGIN = "planner.processes.forming.plan.stages.virgin_sheet_order"
BORDER = "planner.processes.forming.plan.claims.border_curve"
STATES = "planner.processes.forming.plan.claims.sheet_states"
FAULTS = {
    "aside by 0.2 mm": ("virgin", PASSES, move_faces([2e-4, 0.0, 0.0]), PART),
    "mirrored": ("virgin", PASSES, mirror_faces([[-1, 0, 0], [0, 1, 0], [0, 0, 1]]), PART),
    "x and y change places": ("virgin", PASSES, mirror_faces([[0, 1, 0], [1, 0, 0], [0, 0, 1]]), PART),
    "1 mm too low": ("dish", PASSES, move_faces([0.0, 0.0, -1e-3]), PART),
    "0.2 mm too high": ("in place", PASSES, move_faces([0.0, 0.0, 2e-4]), PART),
    "from the other side": (
        "squeezed",
        PASSES,
        change_each(lambda p: dataclasses.replace(p, side=-p.side)),
        PART,
    ),
    "the first shape left out": ("steep", PASSES, change_result(lambda found: found[1:]), PART),
    "the last shape left out": ("steep", PASSES, change_result(lambda found: found[:-1]), PART),
    "a feature left out": ("virgin", PASSES, change_result(lambda found: found[1:]), PART),
    "shapes the other way round": ("steep", PASSES, change_result(lambda found: found[::-1]), PART),
    "features the other way round": ("virgin", PASSES, change_result(lambda found: found[::-1]), PART),
    "outer features first": ("virgin", VIRGIN, lambda _: tree.in_place_order, PART),
    "shapes too far apart": (
        "steep",
        "planner.processes.forming.plan.passes.pass_angles",
        lambda _: lambda angle, *_: (angle - np.deg2rad(30.0), angle),
        PART,
    ),
    "one repeat too few": (
        "passes of one's own",
        PASSES,
        change_result(lambda found: tuple(one for k, one in enumerate(found) if k != 1)),
        PART,
    ),
    "a sine law without the sine": ("squeezed", BY_CORNER, gaps(lambda k, t: np.full_like(k, t)), CLAIMS),
    "squeezed twice": ("squeezed", BY_CORNER, gaps(lambda k, t: 0.9 * k), CLAIMS),
    "a gap on the wrong side": ("squeezed", BY_CORNER, gaps(lambda k, t: -k), CLAIMS),
    "the border aside": ("border", BORDER, change_result(lambda ring: ring + np.array([2e-3, 0, 0])), CLAIMS),
    "the border too low": (
        "border",
        BORDER,
        change_result(lambda ring: ring - np.array([0, 0, 1e-3])),
        CLAIMS,
    ),
    "half a border": ("border", BORDER, change_result(lambda ring: ring[: len(ring) // 2]), CLAIMS),
    "ridges twice as high": (
        "dish",
        "planner.processes.forming.plan.claims.scallop_heights",
        change_result(lambda height: 2.0 * height),
        CLAIMS,
    ),
    "nothing is formed already": (
        "in place",
        STATES,
        change_each(lambda state: dataclasses.replace(state, fixed=state.fixed[:1])),
        CLAIMS,
    ),
    "nothing is carried": (
        "virgin",
        STATES,
        change_each(lambda state: dataclasses.replace(state, carried=state.carried[:0])),
        CLAIMS,
    ),
}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_the_planner_is_told(tmp_path, monkeypatch, name):
    which, place, patch, code = FAULTS[name]
    mode, part, sheet, options = PARTS[which]
    found = problem(tmp_path, mode, part and part(), sheet, **options)
    module, function = place.rsplit(".", 1)
    home = importlib.import_module(module)
    monkeypatch.setattr(home, function, patch(getattr(home, function)))
    assert code in broken_codes(found)


NUMBERS = {
    "half the radius": ("FormsSheet", {"radius": 0.0025}),
    "a wider tolerance": ("FormsSheet", {"tolerance": 1e-3}),
    "less of the part": ("FormsSheet", {"share": 0.6}),
    "ten times the feed": ("FormingFeed", {"upper": 0.25}),
    "only one tool's feed": ("FormingFeed", {"arms": ("left",)}),
    "a wide gap": ("ToolGap", {"tolerance": 2e-4}),
    "tools that face anywhere": ("ToolGap", {"turn": 1.0}),
    "tools that press": ("SheetState", {"tolerance": 1e-3}),
    "a support that presses": ("SheetState", {"other": 1e-3}),
}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_that_are_not_the_user_s_are_told(tmp_path, name):
    kind, fields = NUMBERS[name]

    def change(group):
        return tuple(
            dataclasses.replace(claim, **fields) if type(claim).__name__ == kind else claim for claim in group
        )

    assert broken_codes(problem(tmp_path), change) == {CLAIMS}


@pytest.mark.parametrize("kind", ["ToolGap", "SheetState", "FormingFeed"])
def test_a_claim_that_is_left_out_is_told(tmp_path, kind):
    found = problem(tmp_path)
    assert broken_codes(found, lambda group: tuple(c for c in group if type(c).__name__ != kind)) == {CLAIMS}


def test_passes_of_no_part_and_a_part_without_passes_are_told(tmp_path):
    found = problem(tmp_path)
    assert PART in broken_codes(
        found, lambda group: tuple(c for c in group if type(c).__name__ != "FormsPart")
    )
    assert PART in broken_codes(
        found, lambda group: tuple(c for c in group if type(c).__name__ == "FormsPart")
    )


def test_features_are_numbered_as_users_know_them(tmp_path):
    """By the user's order the dish is 1 and the dome on its floor 2."""
    found = problem(tmp_path, "dsif", lopsided(), WIDE, strategy="virgin", order=[1, 2])
    assert broken_codes(found) == set()
    one, two = Segment("form", "f1"), Segment("form", "f2")
    names = {one: two, two: one}

    def change(group):
        out = []
        for claim in group:
            if hasattr(claim, "segment"):
                claim = dataclasses.replace(claim, segment=names[claim.segment])
            elif hasattr(claim, "segments"):
                claim = dataclasses.replace(claim, segments=tuple(names[s] for s in claim.segments))
            out.append(claim)
        return tuple(out)

    assert PART in broken_codes(found, change)


def test_a_wall_that_turns_back_is_no_single_feature():
    """The dish with a dome as one face: the dome stands up against the tool that forms the dish."""
    part = small_forming.dish_with_a_dome(60)
    claim = next(c for c in forming_job.claims()["dish"] if type(c).__name__ == "FormsSheet")
    low = float(part.vertices[:, 2].min())
    one = dataclasses.replace(claim, vertices=part.vertices, faces=part.faces, start=0.0, end=low)
    place = FormedShape((one,), 0.0, low).turn_back_point(-1.0)
    assert place is not None and np.hypot(place[0], place[1]) < 0.014
    plain = small_forming.dish()
    low = float(plain.vertices[:, 2].min())
    one = dataclasses.replace(claim, vertices=plain.vertices, faces=plain.faces, start=0.0, end=low)
    assert FormedShape((one,), 0.0, low).turn_back_point(-1.0) is None


def test_the_angle_of_a_cone_is_that_of_its_facets():
    """By the faces' own normals; facets are steeper than the cone, for chords are nearer to the axis."""
    part = shapes.cone(45.0, 0.008, 0.03, 60)
    claim = next(c for c in forming_job.claims()["dish"] if type(c).__name__ == "FormsSheet")
    shape = FormedShape((dataclasses.replace(claim, vertices=part.vertices, faces=part.faces),), 0.0, -0.008)
    normals = face_normals(TriangleMesh(part.vertices, part.faces))
    assert shape.wall_angle(0.995) == pytest.approx(float(np.arccos(np.abs(normals[:, 2]).min())), abs=1e-6)


def scanned(noise=1e-4, seed=4):
    """A dish of 60 mm on irregular triangles with noise, as a scan has it."""
    line = small_forming.dish().vertices
    away = np.hypot(line[:, 0], line[:, 1])
    order = np.argsort(away)

    def dish(x, y):
        return np.interp(np.hypot(x, y), away[order], line[order, 2])

    part = nests.sheet(dish, 0.045, 1.5e-3, seed)
    moved = np.random.default_rng(seed).normal(0.0, 1.0, part.vertices.shape) * noise
    return dataclasses.replace(part, vertices=part.vertices + moved)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return problem(tmp_path_factory.mktemp("scan"), "dsif", scanned())


def of_part(**changed):
    """The part's claim with other values."""

    def change(group):
        return tuple(
            dataclasses.replace(claim, **changed) if isinstance(claim, FormsPart) else claim
            for claim in group
        )

    return change


def of_faces(move):
    """Move all faces by the values of ``move`` at their vertices."""

    def move_claim(claim):
        if not hasattr(claim, "vertices") or isinstance(claim, FormsPart):
            return claim
        z = claim.vertices[:, 2] + move(claim.vertices)
        return dataclasses.replace(claim, vertices=np.column_stack([claim.vertices[:, :2], z]))

    return lambda group: tuple(move_claim(claim) for claim in group)


def test_the_claims_of_a_part_with_noise_hold(scan):
    assert broken_codes(scan) == set()


NOISY = {
    "no tolerance": of_part(mesh_tolerance=0.0),
    "a tolerance twice as wide": of_part(mesh_tolerance=6.5e-4),
    "a bump as high as the tolerance": of_faces(
        lambda p: 3.2e-4 * (np.hypot(p[:, 0] - 0.01, p[:, 1]) < 0.01)
    ),
    "all deeper by half the tolerance": of_faces(lambda p: -1.8e-4 * (np.hypot(p[:, 0], p[:, 1]) < 0.03)),
    "a place cut off": of_faces(lambda p: np.where(p[:, 0] > 0.02, 8e-4, 0.0)),
}


@pytest.mark.parametrize(("deep", "seen"), [(0.0, False), (4.5e-4, True)])
def test_a_ridge_that_is_smoothed_away_is_no_noise(scan, deep, seen):
    """2 mm wide and 20 mm long: in no mean of a place, and among no 1 % of the vertices."""
    change = of_faces(lambda p: -deep * ((np.abs(p[:, 1]) < 1e-3) & (np.abs(p[:, 0]) < 0.01)))
    group = {name: change(one) for name, one in registry.claims(scan).items()}
    forming = FormingFacts.__new__(FormingFacts)
    forming.context = Context(scan, group, {})
    forming.context.put(FORMING, forming)
    words = " ".join(issue.message for issue in check_forming_part(forming.context).issues)
    assert ("adjacent vertices" in words) == seen


@pytest.mark.parametrize("name", NOISY)
def test_what_noise_does_not_explain_is_told(scan, name):
    assert PART in broken_codes(scan, NOISY[name])


def test_a_stated_tolerance_is_the_users_and_no_other(tmp_path):
    data = small_forming.problem("dsif")
    data["part"]["sheet_mesh"]["tolerance_mm"] = 0.35
    found = pipeline.load(small_forming.write(tmp_path, data, scanned()))
    assert broken_codes(found) == set()
    assert PART in broken_codes(found, of_part(mesh_tolerance=3e-4))
