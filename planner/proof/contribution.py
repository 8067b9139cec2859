"""What processes and languages contribute to the proof."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from planner.claims.claim import Claim
from planner.issues import Issue, issue_error
from planner.problem import Problem
from planner.proof.context import Claims, Context
from planner.proof.facts import Fact
from planner.proof.part_files.produced import ProducedSheet, SurfaceProducer
from planner.proof.rule import Rule
from planner.proof.rule_order import Stage
from planner.runtime import plugins
from planner.runtime.plugins import PluginError, Process


@dataclasses.dataclass(frozen=True)
class WorkingEdges:
    """Where the working end of an arm's tool may touch the stock.

    Attributes:
        segments: Keys of the segments.
        meet: Whether the working ends of two arms may touch one another there, too.
    """

    segments: frozenset[str]
    meet: bool = False


@dataclasses.dataclass(frozen=True)
class ParallelGroup:
    """Rules that another process may examine while this one examines those before them.

    Attributes:
        name: Name of the group. Rules name it in :attr:`planner.proof.rule.Rule.parallel_group`.
        stage: Stage at whose start the group is submitted.
        useful: Whether the rules have work to do. If not, they run in their usual order.
    """

    name: str
    stage: Stage
    useful: Callable[[Context], bool]


@dataclasses.dataclass(frozen=True)
class ProofOfProcess:
    """The part of the proof that knows a process.

    Attributes:
        rules: The rules. Their order is in :mod:`planner.proof.rule_order`.
        complete: Reads the files that claims name. It takes all claims, and returns the claims with the
            content of the files, and the issues of reading them.
        edges: Where the working end of an arm's tool may touch the stock, according to the claims of one
            operation. None if the claims give the arm no tool of this process.
        facts_at_start: Facts to build at the start of a stage, because another process can work on them
            meanwhile.
        release: Facts to drop after a rule, by its code.
        parallel_groups: Groups of rules that may be examined in another process.
        surface_producer: Surfaces that the process makes of blocks.
        produced_sheet: What the process makes of the sheet of a part file; None if nothing.
        series: Curves for the report, by name. Curves that need a fact that has not been built are left out.
    """

    rules: tuple[Rule, ...]
    complete: Callable[[Claims], tuple[Claims, tuple[Issue, ...]]] | None = None
    edges: Callable[[Sequence[Claim], str], WorkingEdges | None] | None = None
    facts_at_start: Mapping[Stage, tuple[Fact[Context, Any], ...]] = dataclasses.field(default_factory=dict)
    release: Mapping[str, tuple[Fact[Context, Any], ...]] = dataclasses.field(default_factory=dict)
    parallel_groups: tuple[ParallelGroup, ...] = ()
    surface_producer: SurfaceProducer | None = None
    produced_sheet: Callable[[Context, Any], ProducedSheet | None] | None = None
    series: Callable[[Context], Mapping[str, Any]] | None = None


def of_processes(problem: Problem | None = None) -> tuple[ProofOfProcess, ...]:
    """Return the contributions of processes to the proof.

    These are the contributions of all of Tandem's processes, and of those processes of other packages that
    the problem uses (none without a problem).

    Raises:
        TandemError: The contribution of an installed package cannot be loaded (``problem.process_package``).
    """
    used = frozenset(operation.process for operation in problem.operations) if problem else frozenset[str]()
    try:
        return tuple(plugins.parts(Process, "proof", ProofOfProcess, used))
    except PluginError as error:
        raise issue_error("problem.process_package", str(error)) from error


def find_edges(context: Context, index: int, arm: str) -> tuple[WorkingEdges, ...]:
    """Find where the working end of an arm's tool may touch the stock in setup ``index``.

    Each process states it for the claims of each operation of the setup. Operations whose claims give the arm
    no tool of that process are left out.
    """
    groups = context.setup_claims[index].groups
    candidates = (
        contribution.edges(group, arm)
        for contribution in of_processes(context.problem)
        if contribution.edges
        for group in groups
    )
    return tuple(edge for edge in candidates if edge is not None)


def segments_of(all_edges: Iterable[WorkingEdges], meet: bool) -> frozenset[str]:
    """Return the keys of the segments of those working edges whose ``meet`` has a given value."""
    return frozenset[str]().union(*(edge.segments for edge in all_edges if edge.meet is meet))
