"""The end-to-end pipeline: problem -> targets -> plan -> programs -> proof -> output files.

Heavy dependencies (Drake) are imported lazily, so that loading a problem stays fast.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import gc
import logging
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any, Final

from planner import spec
from planner.files import (
    RELEASE,
    RESULT_ENTRIES,
    deferred_sigint,
    is_file,
    prepare_folder,
    write_atomic,
    write_folder,
)
from planner.issue_codes import format_message
from planner.issues import (
    Issue,
    Severity,
    TandemError,
    accepted_codes,
    aggregate,
    apply_acceptances,
    has_errors,
    issue_error,
)
from planner.problem import Cell, Problem
from planner.processes import registry as processes
from planner.reading import problem as problem_file
from planner.reading import size_advice, strict_yaml
from planner.reading.strict_yaml import Document
from planner.runtime import plugins, second_process
from planner.runtime.memory import gc_frozen, release_memory
from planner.runtime.plugins import Language, Process

if TYPE_CHECKING:
    from planner.geometry.arrays import FloatArray
    from planner.motion.reference_plan import ReferencePlan
    from planner.plans import Plan
    from planner.proof.partial import PartialProof
    from planner.proof.verdict import Proof
    from planner.report.cell_picture import Picture
    from planner.report.replay import Viewer
    from planner.runtime.executor import Executor
    from planner.targets import Job, Targets

Progress = Callable[[str, float], None]
"""Function that is called with the name of a stage and its fraction done."""
MAX_PROGRAM_BYTES = 20_000_000
"""Maximum size of a program file that is read [bytes]. Larger than any module that a controller loads."""


def import_dependencies() -> None:
    """Import what planning, proof and report need, including Drake.

    Takes about one second. A process that will plan later may call it early. Ctrl-C is deferred until the
    imports finish, because an interrupted import may lose the signal.
    """
    with deferred_sigint(), gc_frozen():
        from planner import plans  # noqa: F401
        from planner.languages.writing import write  # noqa: F401
        from planner.motion import solve  # noqa: F401
        from planner.proof import partial, prove  # noqa: F401
        from planner.report import output  # noqa: F401


def warm_up() -> None:
    """Import the modules for planning in a process that is about to plan, and silence Drake's information."""
    import_dependencies()
    logging.getLogger("drake").setLevel(logging.WARNING)


WARM_UP: Final = "planner.pipeline:warm_up"
"""Reference to :func:`warm_up`, in the form that a second process takes."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A plan, its programs and their proof.

    Attributes:
        problem: Problem that was planned, with the stations of the plan.
        plan: Motion of all arms.
        proof: Verdict on the programs.
        programs: Program text by file name; empty unless the proof holds.
        pictures: Pictures of the report, if a second process has drawn them.
    """

    problem: Problem
    plan: Plan
    proof: Proof
    programs: Mapping[str, str]
    pictures: tuple[tuple[str, Picture], ...] | None = dataclasses.field(
        default=None, repr=False, compare=False, kw_only=True
    )

    def __repr__(self) -> str:
        held, checked, _ = self.proof.rule_counts
        verdict = "verified" if self.verified else "not verified"
        rules = f"{held} of {checked} rules"
        return f"<Outcome of {self.problem.name}: {verdict}, {rules}, {self.plan.duration:.1f} s>"

    @property
    def verified(self) -> bool:
        """Whether the programs are proven."""
        return self.proof.ok

    @property
    def issues(self) -> tuple[Issue, ...]:
        """All issues of the input, of planning and of the proof, with repeated ones merged and counted."""
        return aggregate((*_input_notes(self.problem), *self.plan.issues, *self.proof.issues))

    @property
    def accepted(self) -> tuple[str, ...]:
        """Codes of errors that occurred and that the problem accepts. They are shown next to the verdict."""
        return accepted_codes(self.plan.issues)

    def save(self, folder: str | Path, progress: Progress | None = None, pages: bool = True) -> None:
        """Write the result folder: plan, motion, report, replay, simulated part, and programs if verified.

        Args:
            folder: Result folder.
            progress: Called with the stage and its fraction done.
            pages: Whether to write report and replay. :func:`planner.cli.results.write_pages` makes them
                later.
        """
        from planner import plans
        from planner.report import motion_file, output

        report_progress = progress or _ignore_progress
        report_progress("report", 0.0)
        files: dict[str, str | bytes] = dict(output.proof_files(self.plan, self.proof, self.programs))
        if pages:
            files |= output.pages(self.problem, self.plan, self.proof, self.pictures)
        files |= plans.dump(self.plan)
        files["motion.json"] = motion_file.motion_json(self.problem, self.plan)
        files |= {f"problem/{name}": text for name, text in problem_file.bundle(self.problem).items()}
        files |= {f"programs/{name}": text for name, text in self.programs.items()}
        write_folder(Path(folder), files, RESULT_ENTRIES)
        report_progress("report", 1.0)

    def show(self, browser: bool | None = None) -> Viewer:
        """Return the viewer of the replay, an animation of the plan that is served on this machine.

        A notebook shows the returned viewer in its cell, with the time bar, and stores it. Outside a notebook
        a browser tab opens.

        Args:
            browser: Whether to open a browser tab; None for only outside a notebook.
        """
        from planner.report import output, replay

        viewer = output.show(self.problem, self.plan, self.proof)
        opens_tab = not replay.in_notebook() if browser is None else browser
        if opens_tab:
            webbrowser.open(viewer.url)
        return viewer


def load(path: str | Path) -> Problem:
    """Read a problem file, or a bundled problem by its name, such as ``column_capital``.

    Raises:
        TandemError: With all faults found.
    """
    return _build_document(strict_yaml.read(problem_file.find_problem(Path(path))))


def build(problem: spec.Problem) -> Problem:
    """Build a problem that is stated in Python.

    Raises:
        TandemError: With all faults found, as :func:`load` reports them for an equivalent file.
        TypeError: If ``problem`` is not a :class:`planner.spec.Problem`.
    """
    if not isinstance(problem, spec.Problem):
        raise TypeError(f"problem must be a planner.spec.Problem, got a {type(problem).__name__}")
    return _build_document(problem.document())


def _build_document(document: Document) -> Problem:
    """Build the problem of a document.

    Raises:
        TandemError: With all faults found. If the only fault is a block or sheet that is too small, its hint
            states a larger size that was tried.
    """
    try:
        return problem_file.build_problem(document, processes.readers())
    except TandemError as error:
        required_widening = functools.partial(_required_widening_mm, document)
        raise TandemError(
            size_advice.add_size_advice(document, error.issues, _check_changed, required_widening)
        ) from None


def _required_widening_mm(document: Document, depth: float, rounded: bool) -> float:
    """Return how much [mm] wider an opening must be for tools that reach ``depth`` [mm] into its clamp.

    The result is the maximum over the processes that the document uses and the built-in ones.
    """
    used_processes = {operation["process"] for operation in document.data["operations"]}
    function_by_process = plugins.loadable(Process, "wider", FunctionType)
    functions = (
        function
        for name, function in function_by_process.items()
        if name in used_processes or plugins.is_built_in(Process, name)
    )
    return max((float(function(depth, rounded)) for function in functions), default=0.0)


def ensure_problem(problem: Problem | spec.Problem) -> Problem:
    """Return a problem ready for planning; a problem stated in Python is built first.

    Raises:
        TandemError: As :func:`build`.
        TypeError: If ``problem`` is not a problem.
    """
    if not isinstance(problem, Problem | spec.Problem):
        raise TypeError(
            f"problem must come from planner.load or planner.spec.Problem, got a {type(problem).__name__}"
        )
    return build(problem) if isinstance(problem, spec.Problem) else problem


def save(problem: Problem | spec.Problem, path: str | Path, overwrite: bool = False) -> Path:
    """Write a problem to a file, with its cell inlined.

    Files that the problem names are copied into ``files/`` next to it.

    Args:
        problem: Problem to write.
        path: File, or folder if the name does not end in ``.yaml`` or ``.yml``.
        overwrite: Whether an existing file with other content may be replaced.

    Returns:
        Path of the written problem file.

    Raises:
        TandemError: ``output.folder`` if another file exists and must not be overwritten, or writing fails;
            ``problem.missing_file`` if a file that the problem names is gone.
    """
    file_or_folder = Path(path)
    is_yaml_name = file_or_folder.suffix.lower() in (".yaml", ".yml")
    target = file_or_folder if is_yaml_name else file_or_folder / "problem.yaml"
    built_problem = ensure_problem(problem)
    try:
        files = problem_file.bundle(built_problem)
    except (OSError, ValueError) as error:
        name = getattr(error, "filename", None)
        message = f"{name or error}: a file that the problem names cannot be read; load or build it again"
        raise issue_error("problem.missing_file", message, file=name) from error
    try:
        if is_file(target) and not overwrite and target.read_bytes() != files["problem.yaml"]:
            message = f"{target}: another file exists; give another name, or overwrite=True"
            raise issue_error("output.folder", message, file=str(target))
        for name, content in reversed(files.items()):  # files that the problem names before the problem
            write_atomic(target if name == "problem.yaml" else target.parent / name, content)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        message = f"{target} cannot be written ({reason}); choose another folder"
        raise issue_error("output.folder", message, file=str(target)) from error
    return target


def _check_changed(document: Document, include_motion: bool) -> list[Issue]:
    """Return the issues of a changed document: its supports and targets, and on request their reach.

    Args:
        document: Document of a problem with a size changed.
        include_motion: Whether to check the reach of the targets too.
    """
    from planner.motion import solve

    problem = problem_file.build_problem(document, processes.readers())
    targets = create_targets(problem, processes.jobs(problem, advise=False))
    issues = [*_support_issues(problem), *(issue for item in targets for issue in item.issues)]
    return [*issues, *(solve.check(problem, targets, with_remedies=False) if include_motion else [])]


@contextlib.contextmanager
def _contain_system_exit() -> Iterator[None]:
    """Convert ``SystemExit`` into ``RuntimeError``.

    Drake raises it for failed conditions, which must not end the process.
    """
    try:
        yield
    except SystemExit as error:
        raise RuntimeError(f"a library aborted: {error}") from error


@_contain_system_exit()
def plan(
    problem: Problem | spec.Problem,
    progress: Progress | None = None,
    processes: int = 1,
    reference: ReferencePlan | str | Path | None = None,
) -> Outcome:
    """Plan, write the text of the programs and prove it.

    Args:
        problem: Problem to plan.
        progress: Called with the stage and its fraction done.
        processes: 2 for a second process, which plans later setups and approaches, draws the pictures of the
            report and checks rules of the proof in parallel. It needs 300 to 550 MB of memory. The result is
            identical.
        reference: Result folder of a similar problem, or what :func:`load_reference_plan` reads from it.
            Placement, joint paths, approaches and retreats are taken from its plan if they suit this problem,
            too. Notes ``motion.like`` name those that were taken.

    Raises:
        TandemError: If no plan is feasible.
    """
    problem, report_progress = ensure_problem(problem), progress or _ignore_progress
    reference_plan = load_reference_plan(reference) if isinstance(reference, str | Path) else reference
    with second_process.open_executor(processes, WARM_UP) as executor:
        return _plan_and_prove(problem, report_progress, executor, processes > 1, reference_plan)


def load_reference_plan(folder: str | Path) -> ReferencePlan:
    """Read the plan of a result folder as the reference plan of a similar problem.

    Raises:
        TandemError: ``plan.missing_file``, ``plan.damaged``, ``plan.schema``, or the faults of the problem in
            the folder.
    """
    from planner.motion.reference_plan import ReferencePlan

    problem, motion_plan = load_planned_result(folder)
    return ReferencePlan(motion_plan, problem)


def _plan_and_prove(
    problem: Problem,
    report_progress: Progress,
    executor: Executor,
    draw: bool,
    reference: ReferencePlan | None,
) -> Outcome:
    """Plan a built problem, write its programs and prove them.

    Args:
        problem: Built problem.
        report_progress: Called with the stage and its fraction done.
        executor: Runs independent work.
        draw: Whether ``executor`` draws the pictures of the report meanwhile.
        reference: Plan of a similar problem, or None.
    """
    report_progress("targets", 0.0)
    import_dependencies()
    from planner.languages.writing import write
    from planner.motion import sag, solve
    from planner.proof import prove
    from planner.report import output, plugin_contributions

    plugin_contributions.process_reports(problem)  # refuse packages without a report before any work
    plugin_contributions.reports_by_language(problem.cell.arms)
    jobs = processes.jobs(problem)
    targets = create_targets(problem, jobs)
    claims = processes.claims(problem, jobs)
    refusals = [*write.refusals(problem, targets), *prove.unproven_claims(claims, problem)]
    if refusals:
        raise TandemError(refusals)
    # motion
    motion_plan = solve.solve(problem, targets, report_progress, executor, reference)
    problem = problem.with_stations(motion_plan.stations)
    _check_executed_timing(jobs, motion_plan, dict.fromkeys(range(len(jobs))))
    pictures = executor.submit(output.pictures, problem, motion_plan) if draw else None
    issues = (*_support_issues(problem), *motion_plan.issues)
    motion_plan = dataclasses.replace(
        motion_plan, issues=aggregate([*issues, *_unused_acceptances(problem, issues)])
    )
    # programs: corrected for sag, and checked with the clock that they execute
    report_progress("programs", 0.0)
    commanded, sag_issues = sag.commanded_plan(problem, motion_plan)
    motion_plan = sag.with_commanded_joints(motion_plan, commanded)
    motion_plan = dataclasses.replace(
        motion_plan, issues=(*motion_plan.issues, *sag_issues, *write.program_notes(commanded, problem))
    )
    files = write.write_programs(commanded, problem)
    programs = files.files
    _check_executed_timing(jobs, motion_plan, files.clocks)
    # proof: the planning of a long job leaves more than 100 MB, which would add to the peak of the proof
    report_progress("proof", 0.0)
    del jobs, targets, files
    gc.collect()
    release_memory()
    proof = prove.prove(problem, claims, programs, executor)
    report_progress("proof", 1.0)
    final = _with_margin_headers(commanded, problem, programs, proof) if proof.ok else {}
    return Outcome(problem, motion_plan, proof, final, pictures=None if pictures is None else tuple(pictures))


def _check_executed_timing(
    jobs: Sequence[Job[Any]], motion_plan: Plan, clocks: Mapping[int, FloatArray | None]
) -> None:
    """Raise the issues that processes find in the executed timing of their operations, if one is an error.

    Args:
        jobs: Jobs of all operations.
        motion_plan: Plan of all operations.
        clocks: {index of an operation: clock of its program (2, K)}, as :meth:`Job.check_timing` takes it.
            None means the clock of the plan.
    """
    issues: list[Issue] = []
    for index, clock in clocks.items():
        motion = motion_plan.operations[index]
        issues += jobs[index].check_timing(motion.targets, motion.time, clock)
    if has_errors(issues):
        raise TandemError(issues)


TargetFactory = Callable[[int, "Job[Any]"], "Targets"]
"""Function that creates the targets of an operation from its index and job.

It may reuse the targets of a similar operation.
"""
QUICK_CHECK_TARGETS = 40
"""Default number of targets that a quick check samples. Chosen: few, because it runs while a user edits."""


@dataclasses.dataclass(frozen=True)
class CheckResult:
    """Result of a check.

    Attributes:
        issues: Issues found.
        checked: Number of targets checked.
        total: Number of all targets; 0 if they cannot be created.
        is_placed: False if a quick check did not find a placement of the stock. A full check searches longer.
        is_subsampled: Whether there were fewer targets than a plan will have.
    """

    issues: tuple[Issue, ...]
    checked: int
    total: int
    is_placed: bool = True
    is_subsampled: bool = False


@_contain_system_exit()
def check(problem: Problem | spec.Problem, advise: bool = True) -> tuple[Issue, ...]:
    """Validate a problem and test reach, without planning.

    Args:
        problem: Problem to check.
        advise: Whether to try changes that may help if there is no path.

    Returns:
        All issues found, errors included.
    """
    return _check(problem, advise, max_targets=None, make=None).issues


@_contain_system_exit()
def quick_check(
    problem: Problem | spec.Problem,
    max_targets: int | None = QUICK_CHECK_TARGETS,
    make: TargetFactory | None = None,
) -> CheckResult:
    """Check a problem as :func:`check`, but only at about ``max_targets`` targets.

    The targets are spread evenly over all operations. The check tests whether each target has a
    collision-free posture with all margins, and whether one of the first placements suits a stock whose
    placement is searched. It does not show that a path exists or that the process achieves its purpose.

    Args:
        problem: Problem to check.
        max_targets: Number of targets to check; None for the full check.
        make: Creates the targets of an operation; None for its job.
    """
    return _check(problem, advise=max_targets is None, max_targets=max_targets, make=make)


def _check(
    problem: Problem | spec.Problem, advise: bool, max_targets: int | None, make: TargetFactory | None
) -> CheckResult:
    """Check a problem, either completely or at about ``max_targets`` targets.

    Errors that end the check become issues of the result.

    Args:
        problem: Problem to check.
        advise: Whether to try changes that may help if there is no path.
        max_targets: Number of targets to check; None for the full check.
        make: Creates the targets of an operation; None for its job.
    """
    try:
        problem = ensure_problem(problem)
    except TandemError as error:
        return CheckResult(error.issues, 0, 0)
    import_dependencies()
    from planner.languages.writing import write
    from planner.motion import solve
    from planner.motion.quick_check import QuickCheck

    notes = _input_notes(problem)
    checked, total = 0, 0
    try:
        targets = create_targets(problem, processes.jobs(problem, brief=max_targets is not None), make)
        total = sum(item.count for item in targets)
        first_look = (
            None if max_targets is None else QuickCheck(tuple(item.count for item in targets), max_targets)
        )
        issues = [*notes, *_support_issues(problem), *(issue for item in targets for issue in item.issues)]
        issues += [*write.refusals(problem, targets), *solve.check(problem, targets, advise, first_look)]
        checked = total if first_look is None else sum(first_look.checked.values())
        is_placed = first_look is None or first_look.is_stock_placed
        if first_look is None:  # in a quick check, the accepted issue may be among those that it leaves out
            issues += _unused_acceptances(problem, issues)
        return CheckResult(
            aggregate(issues), checked, total, is_placed, any(item.is_subsampled for item in targets)
        )
    except TandemError as error:
        return CheckResult((*notes, *error.issues), checked, total)


def create_targets(
    problem: Problem, jobs: Sequence[Job[Any]], make: TargetFactory | None = None
) -> list[Targets]:
    """Create the targets of all jobs, with the acceptances of the problem applied to their issues.

    Args:
        problem: Built problem.
        jobs: Jobs of its operations.
        make: Creates the targets of an operation; None for the job itself.

    Returns:
        The targets of each operation, in order.

    Raises:
        TandemError: With the issues of all jobs and of the supports, if one of them is an error.
    """
    targets_of_jobs: list[Targets] = []
    issues = _support_issues(problem)
    for index, job in enumerate(jobs):
        try:
            targets = job.targets() if make is None else make(index, job)
        except TandemError as error:
            issues += error.issues
        else:
            accepted = apply_acceptances(targets.issues, problem.accept)
            targets_of_jobs.append(dataclasses.replace(targets, issues=accepted))
            issues += accepted
    if len(targets_of_jobs) < len(jobs) or has_errors(issues):
        raise TandemError(aggregate(issues))
    return targets_of_jobs


def _support_issues(problem: Problem) -> list[Issue]:
    """Return issues of the supports of the stock, with the acceptances of the problem applied."""
    from planner.cell import support

    return list(apply_acceptances(support.support_issues(problem), problem.accept))


def _unused_acceptances(problem: Problem, issues: Sequence[Issue]) -> list[Issue]:
    """Return a note for each code that the problem accepts although no issue of that code occurs."""
    return [
        Issue(
            "problem.accepted",
            format_message("problem.accepted", accepted_code=code),
            Severity.NOTE,
            field=f"accept.{number}",
        )
        for number, code in enumerate(problem.accept)
        if code not in accepted_codes(issues)
    ]


def _input_notes(problem: Problem) -> tuple[Issue, ...]:
    """Return notes from reading the problem: what was corrected, chosen or is worth knowing."""
    part = problem.part.notes if problem.part is not None else ()
    return (*part, *problem.notes, *_missing_visuals_notes(problem.cell))


def _missing_visuals_notes(cell: Cell) -> Iterator[Issue]:
    """Yield a note for each custom robot with links whose visual meshes cannot be read.

    Robots with the same such links, as two of the same file, share one note.
    """
    reported: set[tuple[str, ...]] = set()
    for number, arm in enumerate(cell.arms):
        links = arm.data.file.unseen if arm.data.file is not None else ()
        if not links or links in reported:
            continue
        reported.add(links)
        rest_text = f" and {len(links) - 7} more" if len(links) > 7 else ""
        message = f"{len(links)} links of {arm.robot} are shown by their collision bodies, because their "
        message += f"visual meshes cannot be read: {', '.join(links[:7])}{rest_text}"
        field = f"cell.arms.{number}.robot.urdf"
        hint = "put the files next to the URDF or state them under visuals. Only pictures depend on them"
        yield Issue("robot.unseen", message, Severity.NOTE, field=field, hint=hint)


@_contain_system_exit()
def verify(problem: Problem | spec.Problem, programs: Mapping[str, str], processes: int = 1) -> Proof:
    """Prove programs from their text and the problem alone.

    Args:
        problem: Problem that the programs solve.
        programs: Program text by file name.
        processes: 2 for a second process that checks rules in parallel. The verdict is identical.
    """
    problem = ensure_problem(problem)
    with second_process.open_executor(processes, WARM_UP) as executor:
        return _prove(problem, programs, executor)


def _prove(problem: Problem, programs: Mapping[str, str], executor: Executor) -> Proof:
    import_dependencies()
    from planner.proof import prove

    return prove.prove(problem, processes.claims(problem), programs, executor)


def read_partly(problem: Problem | spec.Problem, programs: Mapping[str, str]) -> PartialProof:
    """Report how much of programs of any origin can be read and proven for the cell of ``problem``."""
    problem = ensure_problem(problem)
    import_dependencies()
    from planner.proof import partial

    return partial.prove_partly(problem, programs)


def read_programs(folder: str | Path, bare: bool = False) -> dict[str, str]:
    """Read the program texts in ``folder/programs``, by relative name.

    Args:
        folder: Result folder.
        bare: If there is no folder ``programs``, read the robot programs in ``folder`` itself, for example
            those of another tool.

    Raises:
        TandemError: ``verify.no_programs`` if there are none, ``verify.files`` if one cannot be read.
    """
    root = Path(folder) / "programs"
    is_bare_folder = bare and not root.is_dir()
    root = Path(folder) if is_bare_folder else root
    endings = {ending for language in plugins.usable(Language).values() for ending in language.file_endings}
    texts = {
        p.relative_to(root).as_posix(): _read_program_text(p)
        for p in sorted(root.rglob("*"))
        if p.is_file() and p != root / RELEASE and (not is_bare_folder or p.suffix.lower() in endings)
    }
    if not texts:
        raise issue_error(
            "verify.no_programs", format_message("verify.no_programs", folder=root), file=str(root)
        )
    return texts


def _read_program_text(path: Path) -> str:
    """Read the text of a program file.

    Raises:
        TandemError: ``verify.files`` if it is too large, cannot be read or is not text.
    """
    from planner.programs import text as program_text

    try:
        if path.stat().st_size <= MAX_PROGRAM_BYTES:
            text = program_text.decode(path.read_bytes(), path.name)
            if "\0" not in text:
                return text
            reason = "is not text (it contains the byte 0)"
        else:
            reason = f"is over {MAX_PROGRAM_BYTES // 1_000_000} MB, more than any module of a controller"
    except OSError as error:
        reason = f"cannot be read ({error})"
    except UnicodeDecodeError as error:
        reason = f"is not UTF-8 text ({error})"
    raise issue_error("verify.files", f"{path} {reason}; remove it or plan again", file=str(path))


def load_result(folder: str | Path) -> Problem:
    """Load the problem of a result folder from the copy in its subfolder ``problem``."""
    return load(Path(folder) / "problem" / "problem.yaml")


def load_planned_result(folder: str | Path) -> tuple[Problem, Plan]:
    """Load problem and plan of a result folder, with external axes at the stations of the plan."""
    from planner import plans

    # The plan first, so that the error of a folder that is not a result names the missing plan
    motion_plan = plans.load(folder)
    return load_result(folder).with_stations(motion_plan.stations), motion_plan


def prepare_output(folder: str | Path, problem: str | Path) -> None:
    """Check before any work that results can be written to ``folder`` without harm to the problem file.

    Raises:
        TandemError: ``output.folder`` if this is not so.
    """
    prepare_folder(Path(folder), RESULT_ENTRIES, problem_file.find_problem(Path(problem)))


def save_failure(problem: Problem | None, issues: tuple[Issue, ...], folder: str | Path) -> None:
    """Write only the report, for a problem that was refused or has no plan.

    Older results in the folder are removed.
    """
    import_dependencies()
    from planner.report import output

    write_folder(Path(folder), {"report.html": output.failure_report(problem, issues)}, RESULT_ENTRIES)


def exit_code(outcome: Outcome) -> int:
    """Return the exit code of the command: 0 if the programs are proven without errors, else 4."""
    return 4 if not outcome.verified or has_errors(outcome.issues) else 0


def _with_margin_headers(
    motion_plan: Plan, problem: Problem, programs: Mapping[str, str], proof: Proof
) -> Mapping[str, str]:
    """Return the proven programs with the margins of the proof in their headers.

    Raises:
        TandemError: ``internal.error`` if more than comments of the programs changed by this.
    """
    from planner.languages.writing import write
    from planner.proof import verdict
    from planner.proof.same_program import is_same_program

    final = write.program_files(motion_plan, problem, verdict.shown_results(proof))
    if not is_same_program(programs, final):
        raise issue_error(
            "internal.error", "the header changed more than comments of the proven programs. Report this"
        )
    return final


def _ignore_progress(stage: str, fraction: float) -> None:
    del stage, fraction
