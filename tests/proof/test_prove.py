"""Every kind of claim has rules that prove it, and no other claims are allowed."""

from __future__ import annotations

import dataclasses

import pytest

from planner import pipeline
from planner.claims import claim
from planner.claims.claim import Claim, HoldsStock
from planner.issues import TandemError
from planner.processes import Process, registry
from planner.processes.poses.plan.job import PosedJob
from planner.proof.prove import prove, unproven_claims
from planner.proof.rule_table import built_in, proven_by
from planner.runtime import plugins


@dataclasses.dataclass(frozen=True)
class GluesParts(Claim):
    """A claim of a process that came without a rule."""

    segment: str


def test_every_kind_of_claim_has_rules() -> None:
    kinds = {kind for kind in claim.kinds() if kind.__module__.startswith("planner.")}
    assert set(proven_by(built_in().values())) == kinds
    assert len(kinds) == 36


def test_processes_register_the_kinds_of_claims_that_are_not_general() -> None:
    """Plans with claims of a process can be loaded as soon as the registry has been imported."""
    registered = {kind for own in plugins.parts(Process, "claims", tuple) for kind in own}
    rest = {kind.__name__ for kind in set(proven_by(built_in().values())) - registered}
    assert rest == {"ArmSags", "ContactOnlyIn", "FeedWindow", "HoldsStock", "OneOf", "OperatorDialogue"}


def test_two_kinds_of_claims_cannot_have_the_same_name() -> None:
    """Plan files state kinds by name, so a package must not replace a kind of Tandem."""
    with pytest.raises(TypeError, match=r"planner\.claims\.claim already has a claim HoldsStock"):
        type("HoldsStock", (Claim,), {"__module__": "gauge.claims"})
    assert [kind for kind in claim.kinds() if kind.__name__ == "HoldsStock"] == [HoldsStock]


def test_what_no_rule_looks_at_is_refused_by_name() -> None:
    (issue,) = unproven_claims({"panel": (GluesParts("cut/a"), GluesParts("cut/b"))})
    assert issue.code == "claims.unproven"
    assert "panel: its process claims GluesParts, which no rule of the proof checks" in issue.message
    (empty,) = unproven_claims({"panel": ()})
    assert empty.code == "claims.none"
    assert unproven_claims({}) == []
    problem = pipeline.load("gauge_lanes")
    with pytest.raises(TandemError, match="GluesParts"):
        prove(problem, {"lanes": (GluesParts("cut/a"),)}, {})


class _Glue:
    """A job of gauge_lanes with claims for which no rules exist."""

    def __init__(self, operation, setup, part, more) -> None:  # type: ignore[no-untyped-def]
        self.inner = PosedJob(operation, setup, part)
        self.more = more

    def targets(self):  # type: ignore[no-untyped-def]
        return self.inner.targets()

    def claims(self):  # type: ignore[no-untyped-def]
        return self.more


@pytest.mark.parametrize(("more", "code"), [((GluesParts("cut/a"),), "claims.unproven"), ((), "claims.none")])
def test_a_process_that_claims_so_is_refused_before_any_motion(
    monkeypatch: pytest.MonkeyPatch, more: tuple[HoldsStock, ...], code: str
) -> None:
    problem = pipeline.load("gauge_lanes")
    monkeypatch.setattr(
        registry, "jobs", lambda one: (_Glue(one.operations[0], one.setup_of(0), None, more),)
    )
    stages: list[str] = []
    with pytest.raises(TandemError) as caught:
        pipeline.plan(problem, lambda stage, share: stages.append(stage))
    assert [issue.code for issue in caught.value.issues] == [code]
    assert set(stages) == {"targets"}
