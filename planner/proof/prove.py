"""The proof: from the problem and the program text alone to a verdict, rule by rule.

Rules run in their order (:mod:`planner.proof.rule_order`), and each may rely on those before it. Where a
fault leaves the rules of a stage nothing to examine, that stage and those after it do not run, and the proof
does not hold. Nothing may be claimed that no rule proves, because a reader of the claims would take it as
proven.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any

from planner.claims.claim import ArmSags, Claim, OneOf
from planner.issues import Issue, TandemError, aggregate, has_errors, with_remedy
from planner.problem import Problem
from planner.proof import rule_table, series
from planner.proof.context import Claims, Context
from planner.proof.contribution import Ahead, of_processes
from planner.proof.dialogue import chosen_groups
from planner.proof.rule import Outcome, Rule
from planner.proof.rule_order import FACES, NEEDED, Stage
from planner.proof.rules import clearance, external_axes, text
from planner.proof.verdict import Proof, RuleResult
from planner.runtime.executor import SERIAL, Executor
from planner.runtime.memory import release_memory


def unproven(claims: Claims, problem: Problem | None = None) -> list[Issue]:
    """Find claims that no rule proves, and operations of which nothing is claimed.

    Args:
        claims: Claims by the name of the operation.
        problem: Their problem, for rules of installed packages.
    """
    proven = rule_table.proven_by(rule_table.rules_of(problem))
    out = []
    for name, group in claims.items():
        inner = [c for claim in group if isinstance(claim, OneOf) for one in claim.either for c in one]
        known = (type(claim) for claim in (*group, *inner) if type(claim) not in proven)
        for kind in dict.fromkeys(known):
            what = f"{name}: its process claims {kind.__name__}, which no rule of the proof looks at"
            hint = "give the proof a rule for it, or claim what there are rules for"
            out.append(Issue("claims.unproven", f"{what}; {hint}", field="operations.process"))
        if all(isinstance(claim, ArmSags) for claim in group):
            what = f"{name}: its process claims nothing, so nothing of it would be proven"
            what += "; let it claim what has to hold"
            out.append(Issue("claims.none", what, field="operations.process"))
    return out


@dataclasses.dataclass
class Prover:
    """Proves programs of one problem.

    What does not depend on the programs, such as Drake's models and faces that are claimed, is kept between
    proofs, so that later proofs start at once.

    Attributes:
        problem: The problem.
        claims: Claims by the name of the operation.
        executor: Examines rules that no other rule waits for.
    """

    problem: Problem
    claims: Claims
    executor: Executor = SERIAL
    kept: dict[str, Any] = dataclasses.field(default_factory=dict)
    _completed: tuple[Claims, tuple[Issue, ...]] | None = None

    @functools.cached_property
    def _rules(self) -> Mapping[Stage, tuple[Rule, ...]]:
        return rule_table.by_stage(rule_table.rules_of(self.problem))

    def context(self, programs: Mapping[str, str]) -> Context:
        """Return the context of a proof: the problem as the programs have it, and all claims on it."""
        if self._completed is None:
            self._completed = _completed(self.problem, self.claims)
        context = Context(self.problem, self._completed[0], programs, self._completed[1])
        context.executor, context.kept = self.executor, self.kept
        return chosen_groups(external_axes.standing(context))

    def prove(self, programs: Mapping[str, str], first_error: bool = False, last: str | None = None) -> Proof:
        """Prove programs.

        Args:
            programs: Text by file name.
            first_error: Stop at the first rule that is broken. The verdict is the same.
            last: Stop after the rule with this code. Such a proof never holds.
        """
        run = _Run(self.context(programs), self._rules)
        for _ in run.steps():
            if "verify.reach" in run.results and run.context.long:
                release_memory()  # what a rule leaves free would count beside the next one's arrays
            if (first_error and has_errors(run.issues)) or last in run.results:
                break
        return run.proof()


def _completed(problem: Problem, claims: Claims) -> tuple[Claims, tuple[Issue, ...]]:
    """Read the files that claims name, process by process."""
    issues: list[Issue] = []
    for one in of_processes(problem):
        if one.complete is not None:
            claims, found = one.complete(claims)
            issues += found
    return claims, tuple(issues)


def _examine_ahead(context: Context, codes: tuple[str, ...]) -> Iterator[Outcome]:
    """Examine rules one after the other, in another process. Rules themselves cannot be sent there."""
    rules = {rule.code: rule for rule in rule_table.rules_of(context.problem)}
    for code in codes:
        yield rules[code](context)


class _Run:
    """One proof while it runs."""

    def __init__(self, context: Context, rules: Mapping[Stage, tuple[Rule, ...]]) -> None:
        self.context, self.rules = context, rules
        self.processes = of_processes(context.problem)
        self.results: dict[str, RuleResult] = {}
        self.outcomes: dict[str, Outcome] = {}
        self.issues: list[Issue] = []
        self._ahead: dict[str, Iterator[Outcome]] = {}  # by the code of the rule

    def steps(self) -> Iterator[None]:
        """Run the rules one after the other, and hand control back after each."""
        for stage, rules in self.rules.items():
            if not self._may_begin(stage):
                return
            self._begin(stage)
            for rule in rules:
                outcome = next(self._ahead[rule.code]) if rule.code in self._ahead else rule(self.context)
                self._add(rule, outcome, stage)
                for fact in (fact for one in self.processes for fact in one.release.get(rule.code, ())):
                    self.context.release(fact)
                self.context = outcome.context or self.context
                del outcome  # its arrays would count beside those of the next rule
                yield

    def _may_begin(self, stage: Stage) -> bool:
        """Return whether the rules before a stage leave it something to examine."""
        match stage:
            case "tasks":  # where arms stand follows from the files of their robots
                return not self._broken("verify.robot_model") and self.context.readable
            case "setups":
                return self.context.playable
            case "curves":
                return not self._broken(*NEEDED)
            case "sheets":
                return not self._broken("verify.reach")
        return True

    def _begin(self, stage: Stage) -> None:
        """Submit what another process can do meanwhile."""
        groups = (rule_table.BODIES, *(group for one in self.processes for group in one.ahead))
        if stage == rule_table.BODIES.stage:
            if self.context.long:
                self.context.put(clearance.LOOKS, clearance.begin_looks(self.context))
            self._submit(stage, groups[:1])
        for fact in (fact for one in self.processes for fact in one.begin.get(stage, ())):
            self.context.get(fact)
        self._submit(stage, groups[1:])

    def _submit(self, stage: Stage, groups: tuple[Ahead, ...]) -> None:
        for group in groups:
            if group.stage == stage and group.useful(self.context):
                rules = (rule for some in self.rules.values() for rule in some if rule.ahead == group.name)
                begun = {*self.results, *self._ahead}
                codes = tuple(rule.code for rule in rules if rule.code not in begun)
                found = self.context.executor.submit(_examine_ahead, self.context, codes)
                self._ahead |= dict.fromkeys(codes, found)

    def _broken(self, *codes: str) -> bool:
        return any(code in self.results and not self.results[code].passed for code in codes)

    @functools.cached_property
    def _changed(self) -> text.Marks:
        return text.marks(self.context.job)

    def _add(self, rule: Rule, outcome: Outcome, stage: Stage) -> None:
        self.issues += [
            text.with_form_cause(with_remedy(issue))
            if stage == "text"
            else text.with_pendant_cause(self._changed, with_remedy(issue))
            for issue in outcome.issues
        ]
        self.outcomes[rule.code] = Outcome(faces=outcome.faces, part=outcome.part, series=outcome.series)
        passed = not has_errors(outcome.issues)
        if passed and outcome.nothing:
            result = RuleResult(rule.code, rule.title, True, where=outcome.nothing, applies=False)
        else:
            measure = outcome.worst, outcome.limit, outcome.unit
            where = outcome.where or outcome.nothing
            result = RuleResult(rule.code, rule.title, passed, *measure, where)
        self.results[rule.code] = result

    def proof(self) -> Proof:
        """Return what was found."""
        rules = tuple(
            self.results.get(rule.code)
            or RuleResult(rule.code, rule.title, False, where="not reached", ran=False)
            for some in self.rules.values()
            for rule in some
        )
        curves: dict[str, Any] = {}
        if self.context.playable and "verify.reach" in self.results:
            measured = {code: one.series for code, one in self.outcomes.items() if one.series}
            curves = series.series(self.context, measured)
        shown = [
            self.outcomes[code] for code in dict.fromkeys((*FACES, *self.outcomes)) if code in self.outcomes
        ]
        faces = tuple(face for one in shown for face in one.faces)
        part = next((one.part for one in shown if one.part), "")
        return Proof(self.context.problem.digest, rules, aggregate(self.issues), curves, faces, part)


def prove(
    problem: Problem,
    claims: Mapping[str, tuple[Claim, ...]],
    programs: Mapping[str, str],
    executor: Executor = SERIAL,
) -> Proof:
    """Prove programs from their text.

    What is wrong with the programs is in the proof. The proof is the same whatever ``executor`` is.

    Args:
        problem: The problem.
        claims: Claims by the name of the operation. They follow from the problem.
        programs: Text by file name.
        executor: Examines rules that no other rule waits for.

    Raises:
        TandemError: The programs are so long that they are not examined (``verify.duration``), or the claims
            are such that no rule proves them (``claims.unproven``, ``claims.none``).
    """
    refused = unproven(claims, problem)
    if refused:
        raise TandemError(refused)
    return Prover(problem, claims, executor).prove(programs)
