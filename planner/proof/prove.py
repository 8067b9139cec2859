"""The proof: from the problem and the program text alone to a verdict, rule by rule.

Rules run in their order (:mod:`planner.proof.rule_order`), and each may rely on those before it. If a fault
leaves the rules of a stage nothing to examine, that stage and those after it do not run, and the proof does
not hold. A claim that no rule proves is refused, because a reader of the claims would take it as proven.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any

from planner.claims.claim import ArmSags, Claim, OneOf
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, aggregate, has_errors, with_remedy
from planner.problem import Problem
from planner.proof import rule_table, series
from planner.proof.context import Claims, Context
from planner.proof.contribution import ParallelGroup, of_processes
from planner.proof.dialogue import with_chosen_groups
from planner.proof.rule import Rule, RuleOutcome
from planner.proof.rule_order import FACES, NEEDED, Stage
from planner.proof.rules import clearance, external_axes, text
from planner.proof.verdict import Proof, RuleResult
from planner.runtime.executor import SERIAL, Executor
from planner.runtime.memory import release_memory


def unproven_claims(claims: Claims, problem: Problem | None = None) -> list[Issue]:
    """Return issues about claims that no rule proves, and about operations without claims.

    Claims on the sag of arms (``ArmSags``) do not count as claims of an operation, because they state only
    how arms deflect.

    Args:
        claims: Claims by the name of the operation.
        problem: Their problem, for rules of installed packages.
    """
    proven = rule_table.proven_by(rule_table.rules_of(problem))
    out = []
    for name, group in claims.items():
        inner = [
            inner_claim
            for claim in group
            if isinstance(claim, OneOf)
            for alternative in claim.either
            for inner_claim in alternative
        ]
        unproven = (type(claim) for claim in (*group, *inner) if type(claim) not in proven)
        for kind in dict.fromkeys(unproven):
            message = format_message("claims.unproven", operation=name, claim_type=kind.__name__)
            out.append(Issue("claims.unproven", message, field="operations.process"))
        if all(isinstance(claim, ArmSags) for claim in group):
            message = f"{name}: its process claims nothing, so nothing of it would be proven"
            message += "; add claims for what has to hold"
            out.append(Issue("claims.none", message, field="operations.process"))
    return out


@dataclasses.dataclass
class Prover:
    """Proves programs of one problem.

    Values that do not depend on the programs, such as Drake's models and claimed faces, are kept between
    proofs, so that later proofs start faster.

    Attributes:
        problem: The problem.
        claims: Claims by the name of the operation.
        executor: Examines rules that no other rule waits for.
        cache: Values that are kept between proofs, by name.
    """

    problem: Problem
    claims: Claims
    executor: Executor = SERIAL
    cache: dict[str, Any] = dataclasses.field(default_factory=dict)
    _completed_claims: tuple[Claims, tuple[Issue, ...]] | None = None

    @functools.cached_property
    def _rules(self) -> Mapping[Stage, tuple[Rule, ...]]:
        return rule_table.by_stage(rule_table.rules_of(self.problem))

    def context(self, programs: Mapping[str, str]) -> Context:
        """Return the context of a proof of programs.

        Its problem has the stations that the programs state, and its claims the groups that they choose.
        """
        if self._completed_claims is None:
            self._completed_claims = _read_claimed_files(self.problem, self.claims)
        context = Context(self.problem, self._completed_claims[0], programs, self._completed_claims[1])
        context.executor, context.cache = self.executor, self.cache
        return with_chosen_groups(external_axes.with_text_stations(context))

    def prove(self, programs: Mapping[str, str], first_error: bool = False, last: str | None = None) -> Proof:
        """Prove programs.

        Args:
            programs: Text by file name.
            first_error: Whether to stop at the first rule that fails. The verdict is the same.
            last: Code of a rule after which to stop. Such a proof never holds. By default all rules run.
        """
        run = _ProofRun(self.context(programs), self._rules)
        for _ in run.steps():
            if "verify.reach" in run.results and run.context.is_long:
                release_memory()  # free memory before the next rule allocates its arrays
            if (first_error and has_errors(run.issues)) or last in run.results:
                break
        return run.proof()


def _read_claimed_files(problem: Problem, claims: Claims) -> tuple[Claims, tuple[Issue, ...]]:
    """Return claims with the content of the files that they name, and the issues of reading these."""
    issues: list[Issue] = []
    for contribution in of_processes(problem):
        if contribution.complete is not None:
            claims, file_issues = contribution.complete(claims)
            issues += file_issues
    return claims, tuple(issues)


def _examine_in_process(context: Context, codes: tuple[str, ...]) -> Iterator[RuleOutcome]:
    """Examine rules one after the other, in another process.

    They are named by their codes, because rules themselves cannot be sent to another process.
    """
    rules = {rule.code: rule for rule in rule_table.rules_of(context.problem)}
    for code in codes:
        yield rules[code](context)


class _ProofRun:
    """One proof while it runs.

    Attributes:
        context: Context of the next rule. A rule may replace it.
        results: Results of the rules that have run, by code.
        outcomes: Faces, parts and curves of these rules, by code.
        issues: Issues of all rules so far.
    """

    def __init__(self, context: Context, rules: Mapping[Stage, tuple[Rule, ...]]) -> None:
        self.context, self.rules = context, rules
        self.processes = of_processes(context.problem)
        self.results: dict[str, RuleResult] = {}
        self.outcomes: dict[str, RuleOutcome] = {}
        self.issues: list[Issue] = []
        self._parallel_outcomes: dict[str, Iterator[RuleOutcome]] = {}  # by the code of the rule

    def steps(self) -> Iterator[None]:
        """Run the rules one after the other, and hand control back after each."""
        for stage, rules in self.rules.items():
            if not self._can_start(stage):
                return
            self._start_stage(stage)
            for rule in rules:
                outcome = (
                    next(self._parallel_outcomes[rule.code])
                    if rule.code in self._parallel_outcomes
                    else rule(self.context)
                )
                self._add(rule, outcome, stage)
                for fact in (
                    fact
                    for contribution in self.processes
                    for fact in contribution.release.get(rule.code, ())
                ):
                    self.context.release(fact)
                self.context = outcome.context or self.context
                del outcome  # free its arrays before the next rule runs
                yield

    def _can_start(self, stage: Stage) -> bool:
        """Return whether the results of earlier rules leave a stage something to examine."""
        match stage:
            case "tasks":  # postures of arms depend on the files of their robots
                return not self._has_failed("verify.robot_model") and self.context.is_readable
            case "setups":
                return self.context.is_replayable
            case "curves":
                return not self._has_failed(*NEEDED)
            case "sheets":
                return not self._has_failed("verify.reach")
        return True

    def _start_stage(self, stage: Stage) -> None:
        """Submit work of a stage that another process can do meanwhile, and build the facts at its start."""
        groups = (
            rule_table.BODY_RULES,
            *(group for contribution in self.processes for group in contribution.parallel_groups),
        )
        if stage == rule_table.BODY_RULES.stage:
            if self.context.is_long:
                self.context.put(
                    clearance.CLEARANCE_QUERIES, clearance.submit_clearance_queries(self.context)
                )
            self._submit(stage, groups[:1])
        for fact in (
            fact for contribution in self.processes for fact in contribution.facts_at_start.get(stage, ())
        ):
            self.context.get(fact)
        self._submit(stage, groups[1:])

    def _submit(self, stage: Stage, groups: tuple[ParallelGroup, ...]) -> None:
        """Submit the rules of parallel groups that start with a stage, apart from those that have started."""
        for group in groups:
            if group.stage == stage and group.useful(self.context):
                rules = (
                    rule
                    for stage_rules in self.rules.values()
                    for rule in stage_rules
                    if rule.parallel_group == group.name
                )
                started = {*self.results, *self._parallel_outcomes}
                codes = tuple(rule.code for rule in rules if rule.code not in started)
                outcomes = self.context.executor.submit(_examine_in_process, self.context, codes)
                self._parallel_outcomes |= dict.fromkeys(codes, outcomes)

    def _has_failed(self, *codes: str) -> bool:
        """Return whether one of some rules has run and not passed."""
        return any(code in self.results and not self.results[code].passed for code in codes)

    @functools.cached_property
    def _modified_targets(self) -> text.ModifiedTargets:
        return text.find_modified_targets(self.context.job)

    def _add(self, rule: Rule, outcome: RuleOutcome, stage: Stage) -> None:
        """Record the result of a rule, and its issues with their likely causes and remedies."""
        self.issues += [
            text.with_language_cause(with_remedy(issue))
            if stage == "text"
            else text.with_pendant_cause(self._modified_targets, with_remedy(issue))
            for issue in outcome.issues
        ]
        self.outcomes[rule.code] = RuleOutcome(faces=outcome.faces, part=outcome.part, series=outcome.series)
        passed = not has_errors(outcome.issues)
        if passed and outcome.nothing:
            result = RuleResult(rule.code, rule.title, True, where=outcome.nothing, applies=False)
        else:
            measure = outcome.worst, outcome.limit, outcome.unit
            where = outcome.where or outcome.nothing
            result = RuleResult(rule.code, rule.title, passed, *measure, where)
        self.results[rule.code] = result

    def proof(self) -> Proof:
        """Return the proof as far as rules have run."""
        rules = tuple(
            self.results.get(rule.code)
            or RuleResult(rule.code, rule.title, False, where="not reached", ran=False)
            for stage_rules in self.rules.values()
            for rule in stage_rules
        )
        curves: dict[str, Any] = {}
        if self.context.is_replayable and "verify.reach" in self.results:
            measured = {code: outcome.series for code, outcome in self.outcomes.items() if outcome.series}
            curves = series.motion_series(self.context, measured)
        shown_outcomes = [
            self.outcomes[code] for code in dict.fromkeys((*FACES, *self.outcomes)) if code in self.outcomes
        ]
        faces = tuple(face for outcome in shown_outcomes for face in outcome.faces)
        part = next((outcome.part for outcome in shown_outcomes if outcome.part), "")
        return Proof(self.context.problem.digest, rules, aggregate(self.issues), curves, faces, part)


def prove(
    problem: Problem,
    claims: Mapping[str, tuple[Claim, ...]],
    programs: Mapping[str, str],
    executor: Executor = SERIAL,
) -> Proof:
    """Prove programs from their text.

    Faults of the programs are in the proof, which is the same whatever ``executor`` is.

    Args:
        problem: The problem.
        claims: Claims by the name of the operation. They follow from the problem.
        programs: Text by file name.
        executor: Examines rules that no other rule waits for.

    Raises:
        TandemError: The programs are too long to be examined (``verify.duration``), or no rule proves some
            claims (``claims.unproven``, ``claims.none``).
    """
    refused = unproven_claims(claims, problem)
    if refused:
        raise TandemError(refused)
    return Prover(problem, claims, executor).prove(programs)
