"""The whole way through: problem -> targets -> plan -> programs -> proof -> files. This file is the house in
one page.

Who only reads a problem waits for no Drake: what motion, proof and report need is imported where they begin.
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
from planner.files import RELEASE, RESULT, claim_folder, deferred_sigint, is_file, write_folder, write_whole
from planner.issues import Issue, Severity, TandemError, accepted, aggregate, has_errors, judged, refusal
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
    from planner.motion.former import Former
    from planner.plans import Plan
    from planner.proof.partial import Partial
    from planner.proof.verdict import Proof
    from planner.report.cell_picture import Picture
    from planner.report.replay import Viewer
    from planner.runtime.executor import Executor
    from planner.targets import Job, Targets

Progress = Callable[[str, float], None]
MAX_PROGRAM_BYTES = 20_000_000
"""Programs are read up to this size."""


def ready() -> None:
    """Import what planning, proof and report need, Drake among it: a second of work, which a process that is
    to plan later may do early. Ctrl-C waits for its end: an import that is interrupted may swallow it."""
    with deferred_sigint(), gc_frozen():
        from planner import plans  # noqa: F401
        from planner.languages.writing import write  # noqa: F401
        from planner.motion import solve  # noqa: F401
        from planner.proof import partial, prove  # noqa: F401
        from planner.report import output  # noqa: F401


def warm_up() -> None:
    """Import what planning needs in a process that is about to plan, and hide Drake's informational log."""
    ready()
    logging.getLogger("drake").setLevel(logging.WARNING)


WARM_UP: Final = "planner.pipeline:warm_up"
"""The function above, as a second process gets it."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A plan, its programs and their proof. ``programs`` is empty unless the proof holds; ``pictures`` of the
    report are there where a second process has drawn them."""

    problem: Problem
    plan: Plan
    proof: Proof
    programs: Mapping[str, str]
    pictures: tuple[tuple[str, Picture], ...] | None = dataclasses.field(
        default=None, repr=False, compare=False, kw_only=True
    )

    def __repr__(self) -> str:
        held, asked, _ = self.proof.tally
        verdict = "verified" if self.verified else "not verified"
        rules = f"{held} of {asked} rules"
        return f"<Outcome of {self.problem.name}: {verdict}, {rules}, {self.plan.duration:.1f} s>"

    @property
    def verified(self) -> bool:
        """Whether the programs are proven."""
        return self.proof.ok

    @property
    def issues(self) -> tuple[Issue, ...]:
        """All issues of part, planning and proof, repeats counted."""
        return aggregate((*_notes(self.problem), *self.plan.issues, *self.proof.issues))

    @property
    def accepted(self) -> tuple[str, ...]:
        """Codes of errors that the problem accepts and that are there: they stand beside the verdict."""
        return accepted(self.plan.issues)

    def save(self, folder: str | Path, progress: Progress | None = None, pages: bool = True) -> None:
        """Write the result folder: programs only if verified, plan, motion, report, replay, simulated part.
        Without ``pages`` neither report nor replay, which :func:`planner.cli.results.write_pages` makes."""
        from planner import plans
        from planner.report import motion_file, output

        tell = progress or _silent
        tell("report", 0.0)
        files: dict[str, str | bytes] = dict(output.proof_files(self.plan, self.proof, self.programs))
        if pages:
            files |= output.pages(self.problem, self.plan, self.proof, self.pictures)
        files |= plans.dump(self.plan)
        files["motion.json"] = motion_file.text(self.problem, self.plan)
        files |= {f"problem/{name}": text for name, text in problem_file.bundle(self.problem).items()}
        files |= {f"programs/{name}": text for name, text in self.programs.items()}
        write_folder(Path(folder), files, RESULT)
        tell("report", 1.0)

    def show(self, browser: bool | None = None) -> Viewer:
        """The replay. A notebook shows what this returns in its cell, with the time bar, and keeps it; else
        it is served on this machine, and a tab of the browser opens, unless ``browser`` says otherwise."""
        from planner.report import output, replay

        viewer = output.show(self.problem, self.plan, self.proof)
        if not replay.in_notebook() if browser is None else browser:
            webbrowser.open(viewer.url)
        return viewer


def load(path: str | Path) -> Problem:
    """Read a problem file, or a bundled problem by its name, such as ``column_capital``.

    Raises ``TandemError`` with every fault found.
    """
    return _read(strict_yaml.read(problem_file.find(Path(path))))


def build(problem: spec.Problem) -> Problem:
    """The problem that is said in Python. Raises ``TandemError`` with every fault found, as :func:`load` of
    a file that says the same would."""
    if not isinstance(problem, spec.Problem):
        raise TypeError(f"got a {type(problem).__name__}, wanted is a planner.spec.Problem")
    return _read(problem.document())


def _read(document: Document) -> Problem:
    try:
        return problem_file.build(document, processes.readers())
    except TandemError as error:
        wider = functools.partial(_wider, document)
        raise TandemError(size_advice.advised(document, error.issues, _changed, wider)) from None


def _wider(document: Document, depth: float, rounded: bool) -> float:
    """By how much [mm] an opening must be wider for tools that reach ``depth`` [mm] into its clamp: the most
    that a process states."""
    named = {operation["process"] for operation in document.data["operations"]}
    known = plugins.loadable(Process, "wider", FunctionType).items()
    found = (one for name, one in known if name in named or plugins.is_built_in(Process, name))
    return max((float(one(depth, rounded)) for one in found), default=0.0)


def built(problem: Problem | spec.Problem) -> Problem:
    """A problem as it is planned: built where it is said in Python. Raises as :func:`build`."""
    if not isinstance(problem, Problem | spec.Problem):
        what = f"got a {type(problem).__name__}, wanted is what planner.load or planner.spec.Problem gives"
        raise TypeError(what)
    return build(problem) if isinstance(problem, spec.Problem) else problem


def save(problem: Problem | spec.Problem, path: str | Path, overwrite: bool = False) -> Path:
    """Write a problem as a file that says the same, with its cell inside and what it names beside it in
    ``files/``; the file's path. Where ``path`` does not end in ``.yaml`` or ``.yml`` it is a folder.

    Raises ``TandemError``: ``output.folder`` where another file is in the way and is not to be overwritten,
    ``problem.missing_file`` where what the problem names is gone.
    """
    given = Path(path)
    target = given if given.suffix.lower() in (".yaml", ".yml") else given / "problem.yaml"
    own = built(problem)
    try:
        files = problem_file.bundle(own)
    except (OSError, ValueError) as error:
        name = getattr(error, "filename", None)
        what = f"{name or error}: what the problem names cannot be read; load or build it again"
        raise refusal("problem.missing_file", what, file=name) from error
    try:
        if is_file(target) and not overwrite and target.read_bytes() != files["problem.yaml"]:
            what = f"{target}: there is another file; give another name, or overwrite=True"
            raise refusal("output.folder", what, file=str(target))
        for name, content in reversed(files.items()):  # what the problem names before the problem
            write_whole(target if name == "problem.yaml" else target.parent / name, content)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        what = f"{target} cannot be written ({reason}); choose a folder of your own"
        raise refusal("output.folder", what, file=str(target)) from error
    return target


def _changed(document: Document, far: bool) -> list[Issue]:
    """Issues of a changed problem before motion, and with ``far`` of a first look at that too."""
    from planner.motion import solve

    problem = problem_file.build(document, processes.readers())
    targets = targets_of(problem, processes.jobs(problem, advise=False))
    found = [*_stands(problem), *(issue for item in targets for issue in item.issues)]
    return [*found, *(solve.check(problem, targets, advise=False) if far else [])]


@contextlib.contextmanager
def _contained() -> Iterator[None]:
    """Drake tells of conditions of its own that fail by ``SystemExit``: which is to end no process."""
    try:
        yield
    except SystemExit as error:
        raise RuntimeError(f"a library gave up: {error}") from error


@_contained()
def plan(
    problem: Problem | spec.Problem,
    progress: Progress | None = None,
    processes: int = 1,
    like: Former | str | Path | None = None,
) -> Outcome:
    """Plan, write the programs' text and prove it. Raises ``TandemError`` where no plan is feasible.

    ``like``: the result folder of a problem like this one, or what :func:`former` reads of it. Place, paths
    and ways are taken over from its plan where they hold; notes (``motion.like``) tell which.

    With ``processes=2`` a second process plans later setups and ways home, draws the report's pictures and
    looks at rules of the proof beside this one, with 300 to 550 MB of memory of its own; what comes out is
    the same byte by byte.
    """
    problem, tell = built(problem), progress or _silent
    before = former(like) if isinstance(like, str | Path) else like
    with second_process.open_executor(processes, WARM_UP) as executor:
        return _planned(problem, tell, executor, processes > 1, before)


def former(folder: str | Path) -> Former:
    """The plan in a result folder, which another one may be planned like. Raises ``TandemError``
    (``plan.missing_file``, ``plan.damaged``, ``plan.schema``, or what is wrong with the problem in it)."""
    from planner.motion.former import Former

    problem, made = planned_result(folder)
    return Former(made, problem)


def _planned(
    problem: Problem, tell: Progress, executor: Executor, draw: bool, before: Former | None
) -> Outcome:
    """What :func:`plan` gives; ``executor`` runs independent work, with ``draw`` the pictures too;
    ``before``: what it is planned like."""
    tell("targets", 0.0)
    ready()
    from planner.languages.writing import write
    from planner.motion import sag, solve
    from planner.proof import prove
    from planner.report import contribution, output

    contribution.of_processes(problem)  # refuse packages that cannot report before any work
    contribution.by_language(problem.cell.arms)
    jobs = processes.jobs(problem)
    targets = targets_of(problem, jobs)
    claims = processes.claims(problem, jobs)
    refused = [*write.refusals(problem, targets), *prove.unproven(claims, problem)]
    if refused:
        raise TandemError(refused)
    made = solve.solve(problem, targets, tell, executor, before)
    problem = problem.stationed(made.stations)
    _as_driven(jobs, made, dict.fromkeys(range(len(jobs))))
    drawn = executor.submit(output.pictures, problem, made) if draw else None
    issues = (*_stands(problem), *made.issues)
    made = dataclasses.replace(made, issues=aggregate([*issues, *_unused(problem, issues)]))
    tell("programs", 0.0)
    commanded, sagging = sag.commanded(problem, made)
    made = sag.noted(made, commanded)
    made = dataclasses.replace(made, issues=(*made.issues, *sagging, *write.notes(commanded, problem)))
    files = write.written(commanded, problem)
    programs = files.files
    _as_driven(jobs, made, files.clocks)
    tell("proof", 0.0)
    del jobs, targets, files  # what the proof has no need of
    gc.collect()
    release_memory()  # of a long job motion leaves more than 100 MB, beside which the proof would count
    proof = prove.prove(problem, claims, programs, executor)
    tell("proof", 1.0)
    final = _with_margins(commanded, problem, programs, proof) if proof.ok else {}
    return Outcome(problem, made, proof, final, pictures=None if drawn is None else tuple(drawn))


def _as_driven(jobs: Sequence[Job[Any]], made: Plan, clocks: Mapping[int, FloatArray | None]) -> None:
    """Raise what processes say of the motion of operations {index: clock}: by the clock of its programs, or,
    for None, by its own."""
    slow: list[Issue] = []
    for index, clock in clocks.items():
        motion = made.operations[index]
        slow += jobs[index].driven(motion.targets, motion.time, clock)
    if has_errors(slow):
        raise TandemError(slow)


Make = Callable[[int, "Job[Any]"], "Targets"]
"""What makes the targets of an operation, by its index; it may know those of an operation like it."""
FIRST_TARGETS = 40
"""Targets that a first look is at."""


@dataclasses.dataclass(frozen=True)
class Looked:
    """What a check found, and at how many ``targets`` of all of them it looked; none of none where they
    cannot be made. ``placed``: whether a first look has a place for the block, which a whole one searches
    longer; ``thinned``: whether it was made of fewer targets than the plan will have."""

    issues: tuple[Issue, ...]
    targets: int
    of: int
    placed: bool = True
    thinned: bool = False


@_contained()
def check(problem: Problem | spec.Problem, advise: bool = True) -> tuple[Issue, ...]:
    """Validate and test reach without planning: the issues found, errors included. ``advise``: where there is
    no path, changes that may help are tried."""
    return _checked(problem, advise, None, None).issues


@_contained()
def looked_over(
    problem: Problem | spec.Problem, most: int | None = FIRST_TARGETS, make: Make | None = None
) -> Looked:
    """As :func:`check`, at about ``most`` targets alone, evenly spread over all operations: whether
    each has a posture with all margins that is free, and whether one of the first places will do for a
    block whose place is searched. None of it says that there is a path, or that the process does what it
    should; with ``most`` None it is the whole check."""
    return _checked(problem, most is None, most, make)


def _checked(problem: Problem | spec.Problem, advise: bool, most: int | None, make: Make | None) -> Looked:
    try:
        problem = built(problem)
    except TandemError as error:
        return Looked(error.issues, 0, 0)
    ready()
    from planner.languages.writing import write
    from planner.motion import solve
    from planner.motion.first_look import FirstLook

    notes = _notes(problem)
    looked, of = 0, 0
    try:
        targets = targets_of(problem, processes.jobs(problem, brief=most is not None), make)
        of = sum(item.count for item in targets)
        first = None if most is None else FirstLook(tuple(item.count for item in targets), most)
        found = [*notes, *_stands(problem), *(issue for item in targets for issue in item.issues)]
        found += [*write.refusals(problem, targets), *solve.check(problem, targets, advise, first)]
        looked = of if first is None else sum(first.looked.values())
        placed = first is None or first.placed
        if first is None:  # what a first look does not judge may be there all the same
            found += _unused(problem, found)
        return Looked(aggregate(found), looked, of, placed, any(item.thinned for item in targets))
    except TandemError as error:
        return Looked((*notes, *error.issues), looked, of)


def targets_of(problem: Problem, jobs: Sequence[Job[Any]], make: Make | None = None) -> list[Targets]:
    """The targets of all jobs, with what the problem accepts of their issues; ``make`` makes them where it is
    given. Raises ``TandemError`` with the errors of all of them."""
    out: list[Targets] = []
    told = _stands(problem)
    for index, job in enumerate(jobs):
        try:
            made = job.targets() if make is None else make(index, job)
        except TandemError as error:
            told += error.issues
        else:
            out.append(dataclasses.replace(made, issues=judged(made.issues, problem.accept)))
            told += out[-1].issues
    if len(out) < len(jobs) or has_errors(told):
        raise TandemError(aggregate(told))
    return out


def _stands(problem: Problem) -> list[Issue]:
    """What is to be told of what the blocks stand on."""
    from planner.cell import support

    return list(judged(support.issues(problem), problem.accept))


def _unused(problem: Problem, found: Sequence[Issue]) -> list[Issue]:
    """Notes of what the problem accepts and nobody has found."""
    return [
        Issue(
            "problem.accepted",
            f"accept: {code} does not occur; take it out, lest it hides one that comes later",
            Severity.NOTE,
            field=f"accept.{number}",
        )
        for number, code in enumerate(problem.accept)
        if code not in accepted(found)
    ]


def _notes(problem: Problem) -> tuple[Issue, ...]:
    """What was put right, or is to be known, on the way from the file to the part."""
    part = problem.part.notes if problem.part is not None else ()
    return (*part, *problem.notes, *_unseen(problem.cell))


def _unseen(cell: Cell) -> Iterator[Issue]:
    """A note for each robot of the user's own of which not all is seen as its maker drew it."""
    told: set[tuple[str, ...]] = set()
    for number, arm in enumerate(cell.arms):
        unseen = arm.data.file.unseen if arm.data.file is not None else ()
        if not unseen or unseen in told:
            continue
        told.add(unseen)
        more = f" and {len(unseen) - 7} more" if len(unseen) > 7 else ""
        what = f"of {len(unseen)} links of {arm.robot} the bodies for collision are shown, for what the URDF "
        what += f"has to be seen cannot be read: {', '.join(unseen[:7])}{more}"
        field = f"cell.arms.{number}.robot.urdf"
        hint = "lay them beside the URDF or state them under visuals. Nothing but "
        yield Issue("robot.unseen", what, Severity.NOTE, field=field, hint=f"{hint}pictures depends on it")


@_contained()
def verify(problem: Problem | spec.Problem, programs: Mapping[str, str], processes: int = 1) -> Proof:
    """Prove programs from their text and the problem alone; ``processes`` as for :func:`plan`."""
    problem = built(problem)
    with second_process.open_executor(processes, WARM_UP) as executor:
        return _proven(problem, programs, executor)


def _proven(problem: Problem, programs: Mapping[str, str], executor: Executor) -> Proof:
    ready()
    from planner.proof import prove

    return prove.prove(problem, processes.claims(problem), programs, executor)


def read_partly(problem: Problem | spec.Problem, programs: Mapping[str, str]) -> Partial:
    """How much of programs of any origin is read and proven, for the cell of ``problem``."""
    problem = built(problem)
    ready()
    from planner.proof import partial

    return partial.read_partly(problem, programs)


def read_programs(folder: str | Path, bare: bool = False) -> dict[str, str]:
    """The texts in ``folder/programs``, by relative name; ``bare``: those of robot programs in ``folder``
    itself where it has no such folder, such as somebody else's. Raises ``TandemError`` if there are none."""
    root = Path(folder) / "programs"
    alone = bare and not root.is_dir()
    root = Path(folder) if alone else root
    endings = {ending for one in plugins.usable(Language).values() for ending in one.file_endings}
    texts = {
        p.relative_to(root).as_posix(): _text(p)
        for p in sorted(root.rglob("*"))
        if p.is_file() and p != root / RELEASE and (not alone or p.suffix.lower() in endings)
    }
    if not texts:
        raise refusal(
            "verify.no_programs", f"{root}: no programs there; plan the problem first", file=str(root)
        )
    return texts


def _text(path: Path) -> str:
    from planner.programs import text as program_text

    try:
        if path.stat().st_size <= MAX_PROGRAM_BYTES:
            text = program_text.decode(path.read_bytes(), path.name)
            if "\0" not in text:
                return text
            what = "is no text (it holds the byte 0)"
        else:
            what = f"is over {MAX_PROGRAM_BYTES // 1_000_000} MB, which no module of a controller is"
    except OSError as error:
        what = f"cannot be read ({error})"
    except UnicodeDecodeError as error:
        what = f"is not text in UTF-8 ({error})"
    raise refusal("verify.files", f"{path} {what}; take it away or plan again", file=str(path))


def load_result(folder: str | Path) -> Problem:
    """The problem that a result folder was made for, from the copy that it carries."""
    return load(Path(folder) / "problem" / "problem.yaml")


def planned_result(folder: str | Path) -> tuple[Problem, Plan]:
    """Problem and plan of a result folder, arms on tracks at the plan's stations."""
    from planner import plans

    made = plans.load(folder)  # first: what a folder that is no plan lacks is the plan
    return load_result(folder).stationed(made.stations), made


def claim_output(folder: str | Path, problem: str | Path) -> None:
    """See before any work that results can be written to ``folder`` without harm to the problem file.

    Raises ``TandemError`` with ``output.folder``.
    """
    claim_folder(Path(folder), RESULT, problem_file.find(Path(problem)))


def save_failure(problem: Problem | None, issues: tuple[Issue, ...], folder: str | Path) -> None:
    """Write the report alone, for a problem that was refused or has no plan; removes what an older run
    left.
    """
    ready()
    from planner.report import output

    write_folder(Path(folder), {"report.html": output.failure(problem, issues)}, RESULT)


def exit_code(outcome: Outcome) -> int:
    """0 for done and verified, 4 for planned but not proven."""
    return 4 if not outcome.verified or has_errors(outcome.issues) else 0


def _with_margins(
    made: Plan, problem: Problem, programs: Mapping[str, str], proof: Proof
) -> Mapping[str, str]:
    """The proven programs with the proof's margins in their headers, which must change comments alone."""
    from planner.languages.writing import write
    from planner.proof import verdict
    from planner.proof.same_program import same_program

    final = write.programs(made, problem, verdict.text(proof))
    if not same_program(programs, final):
        raise refusal(
            "internal.error", "the header changed more than comments of the proven programs; report this"
        )
    return final


def _silent(stage: str, fraction: float) -> None:
    del stage, fraction
