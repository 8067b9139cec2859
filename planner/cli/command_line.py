"""The command line: each command of ``tandem`` is a function here, and ``main`` is the entry point."""

from __future__ import annotations

import _thread
import functools
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Annotated, NoReturn, ParamSpec

import tyro
from rich.table import Table

from planner.cli import batch as batch_commands
from planner.cli import clamp as clamp_commands
from planner.cli import element as element_commands
from planner.cli import forming as forming_commands
from planner.cli import loading as loading_commands
from planner.cli import loop as loop_commands
from planner.cli import preparation as preparation_commands
from planner.cli import robots as robot_commands
from planner.cli import scan as scan_commands
from planner.cli import service as service_commands
from planner.cli import statement
from planner.cli.console import err, out, print_accepted, print_issues, print_summary, progress_bar
from planner.cli.verification import compare_with_file, record_proof, sign_folder
from planner.files import deferred_sigint
from planner.issues import Issue, Severity, TandemError, accepted, given_wrong, has_errors
from planner.runtime.memory import gc_frozen

DONE, FAILED, BAD_INPUT, NO_PLAN, NOT_PROVEN, NOT_COMPARED = 0, 1, 2, 3, 4, 5
"""Exit codes of the command."""
app = tyro.extras.SubcommandApp()
P = ParamSpec("P")


def _infeasible_code(error: TandemError) -> int:
    return BAD_INPUT if given_wrong(error.issues) else NO_PLAN


def _failed_code(error: TandemError) -> int:
    return BAD_INPUT if given_wrong(error.issues) else FAILED


def _command(
    code: Callable[[TandemError], int] = lambda _: BAD_INPUT, name: str | None = None
) -> Callable[[Callable[P, int | None]], Callable[P, int]]:
    """Make a function a command of that ``name``, by default its own.

    The exit code is what the function returns, `DONE` for None. The issues of a ``TandemError`` are printed,
    and ``code`` gives its exit code.
    """

    def registered(function: Callable[P, int | None]) -> Callable[P, int]:
        @functools.wraps(function)
        def run(*args: P.args, **kwargs: P.kwargs) -> int:
            try:
                return function(*args, **kwargs) or DONE
            except TandemError as error:
                return _refused(error, code(error))

        app.command(name=name)(run)
        return run

    return registered


@_command()
def plan(
    problem: tyro.conf.Positional[Path],
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out"),
    sign: Path | None = None,
    like: Path | None = None,
) -> int:
    """Plan a problem file, prove the programs and write them with a report; exit 0 only if verified.

    Args:
        problem: the problem file, YAML.
        output: folder for programs, report, replay and plan.
        sign: an Ed25519 key of OpenSSH, by which the result is signed if it is verified.
        like: the result folder of a problem like this one: place, paths and ways are taken over where they
            hold.
    """
    started = time.perf_counter()
    with progress_bar() as progress:
        progress("reading", 0.0)  # before what is imported for it
        pipeline = _pipeline()
        try:
            key = None if sign is None else statement.read_private_key(sign)
            pipeline.claim_output(output, problem)
            former = None if like is None else pipeline.former(like)
        except TandemError as error:
            return _refused(error, BAD_INPUT)
        try:
            loaded = pipeline.load(problem)
        except TandemError as error:
            pipeline.save_failure(None, error.issues, output)
            return _refused(error, BAD_INPUT)
        progress("reading", 1.0)
        try:
            outcome = pipeline.plan(loaded, progress, _processes(), former)
            outcome.save(output, progress)
        except TandemError as error:
            pipeline.save_failure(loaded, error.issues, output)
            return _refused(error, _infeasible_code(error))
    print_issues(outcome.issues)
    print_summary(outcome, output, time.perf_counter() - started)
    if key is not None and not sign_folder(output, loaded, outcome.proof, key):
        return NOT_PROVEN
    return int(pipeline.exit_code(outcome))


@_command()
def check(problem: tyro.conf.Positional[Path]) -> int:
    """Validate a problem file and test reach, without planning."""
    pipeline = _pipeline()
    loaded = pipeline.load(problem)
    issues = pipeline.check(loaded)
    print_issues(issues)
    if has_errors(issues):
        return _infeasible_code(TandemError([i for i in issues if i.severity is Severity.ERROR]))
    out.print(f"{loaded.name}: nothing in the way of a plan was found")
    print_accepted(accepted(issues))
    return DONE


@_command()
def verify(
    folder: tyro.conf.Positional[Path],
    problem: Path | None = None,
    sign: Path | None = None,
    signed_by: Path | None = None,
) -> int:
    """Prove the programs in a result folder again, from their text and the problem alone.

    Args:
        folder: a result folder; of it, only programs/ and problem/ are read, and proof.json is written anew.
            With ``problem``, also a folder of programs that somebody else has written: what of them can be
            read and proven is told, and nothing is written.
        problem: your own problem file, to prove against instead of the copy in the folder, and to compare
            that copy with.
        sign: an Ed25519 key of OpenSSH, by which the result is signed if it is proven.
        signed_by: a public key, or a file of allowed signers, by which the result must be signed.
    """
    pipeline = _pipeline()
    key = None if sign is None else statement.read_private_key(sign)
    loaded = pipeline.load_result(folder) if problem is None else pipeline.load(problem)
    signature = () if signed_by is None else statement.check_signed(folder, loaded, signed_by)
    print_issues(compare_with_file(pipeline, folder, loaded, problem))
    print_issues(signature)
    programs = pipeline.read_programs(folder, bare=problem is not None)
    try:
        proof = pipeline.verify(loaded, programs, _processes())
        foreign = problem is not None and not proof.read
        partly = pipeline.read_partly(loaded, programs) if foreign else None
    except TandemError as error:
        return _refused(error, NOT_PROVEN)
    if partly is not None:
        print_issues(partly.issues)
        out.print(f"{loaded.name}: not read as a whole; each on its own, proven are {partly.share}")
    else:
        print_issues(proof.issues)
    held, asked, others = proof.tally
    rules = f"{held} of {asked} rules hold" + (
        f", {others} ask about what is not done here" if others else ""
    )
    out.print(f"{loaded.name}: {rules}; {'proven' if proof.ok else 'NOT proven'}")
    print_accepted(loaded.accept)
    if problem is None:
        record_proof(folder, programs, proof, key is not None)
    if key is not None and not sign_folder(folder, loaded, proof, key):
        return NOT_PROVEN
    return DONE if proof.ok and not has_errors(signature) else NOT_PROVEN


@_command()
def report(folders: tyro.conf.Positional[tuple[Path, ...]], maps: bool = False) -> int:
    """Write report and replay into result folders, with the proof of their programs made anew.

    Args:
        folders: result folders, such as those that ``tandem batch --reports failed`` left without.
        maps: show of each freedom, over some of the targets, where each arm is free, what is in its way
            elsewhere, and how the plan goes through it.
    """
    _pipeline()
    from planner.cli import results

    code = DONE
    for folder in folders:
        try:
            proof = results.write_pages(folder, _processes(), maps)
        except TandemError as error:
            code = max(code, _refused(error, BAD_INPUT))
            continue
        verdict = "proven" if proof.ok else "NOT proven"
        out.print(f"{folder}: {verdict}; see {folder / 'report.html'}", highlight=False, markup=False)
        code = code if proof.ok else NOT_PROVEN
    return code


@_command()
def export(
    folder: tyro.conf.Positional[Path],
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    time: float = 0.0,
    machine: str | None = None,
    reverse: str = "",
) -> None:
    """Write the cell, the part and the ways of a result folder for CAD programs: GLB, or 3DM for Rhino; or
    what was milled as G-code for a five-axis machine.

    Args:
        folder: a result folder of ``tandem plan``.
        output: the file, which ends in ``.glb``, ``.3dm`` or ``.ngc``.
        time: the moment that is shown [s], from the plan's first target.
        machine: what carries what on the machine that a ``.ngc`` file is for, as ``convention`` says it of
            G-code files. Nothing is proven of that machine.
        reverse: letters of its rotary axes that count the other way round, as those of tables do that state
            the tool's motion against the table (ISO 841).
    """
    _pipeline()
    from planner.cli import results

    written = results.export(folder, output, time, machine, reverse)
    out.print(f"written to {written}", highlight=False, markup=False)


@_command(_failed_code)
def upload(request: tyro.conf.OmitArgPrefixes[loading_commands.Upload]) -> int:
    """Send verified programs to a controller, a share or an FTP folder; nothing is loaded or started. Exit 0
    where all that is read of the controller agreed, 5 where something of it was not looked at."""
    _pipeline()
    sent = loading_commands.run_upload(request)
    return DONE if sent.ready else NOT_COMPARED


@_command(_failed_code)
def download(request: tyro.conf.OmitArgPrefixes[loading_commands.Download]) -> int:
    """Bring programs back from a controller, name what was touched up there, and prove them again: the exit
    code is that of the proof."""
    _pipeline()
    found, proof = loading_commands.run_download(request)
    print_issues(loading_commands.shortened(found))
    print_issues(proof.issues)
    sent = f"touched up in {len(found)} places" if found else "as it was sent"
    out.print(f"{sent}; {'proven' if proof.ok else 'NOT proven'}", highlight=False)
    out.print("These are the files there; what is loaded was not read: save modules before.", highlight=False)
    return DONE if proof.ok else NOT_PROVEN


@_command()
def robots(name: tyro.conf.Positional[str | None] = None) -> None:
    """List the robots that are built in, or tell of one of them where its figures come from.

    Args:
        name: the robot that is told of.
    """
    robot_commands.show(name)


@_command(name="robots-add")
def robots_add(request: tyro.conf.OmitArgPrefixes[robot_commands.Add]) -> None:
    """Check the URDF of an arm of your own and write it down for a cell: `tandem robots add` is the same."""
    robot_commands.run_add(request)


@_command()
def materials() -> None:
    """List the materials of wires, foams and sheets: their figures, each with its value and source."""
    from planner.catalogue import materials

    table = Table("name", "material", "figure", "value", "source")
    for name, title, figure, value, source in [*materials.figures(), *materials.sheet_metal_figures()]:
        table.add_row(name, title, figure.replace("_", " "), value, source)
    out.print(table)


@_command()
def kerf(action: preparation_commands.Action) -> None:
    """Fit a foam of your own from test cuts, or ask for a kerf, a speed or a power."""
    preparation_commands.run_kerf(action)


@_command()
def align(request: tyro.conf.OmitArgPrefixes[preparation_commands.Align]) -> None:
    """Find the base of a cell's second robot from points that both robots probed."""
    print_issues(preparation_commands.run_align(request))


@_command()
def features(request: tyro.conf.OmitArgPrefixes[preparation_commands.Features]) -> None:
    """Show the features of a sheet part as a tree, in the order of forming, and draw them."""
    print_issues(preparation_commands.run_features(request))


@_command(_infeasible_code)
def springback(request: tyro.conf.OmitArgPrefixes[forming_commands.Springback]) -> None:
    """Foretell how far a formed part comes back when the tools let go, before it is formed."""
    pipeline = _pipeline()
    print_issues(forming_commands.run_springback(request, pipeline.load(request.problem)))


@_command(_infeasible_code)
def control(request: tyro.conf.OmitArgPrefixes[forming_commands.ControlRequest]) -> None:
    """Gains of force control and compensation for a machine that you measured, run in time."""
    pipeline = _pipeline()
    print_issues(forming_commands.run_control(request, pipeline.load(request.problem)))


@_command(_infeasible_code, name="calibrate-clamp")
def calibrate_clamp(request: tyro.conf.OmitArgPrefixes[clamp_commands.CalibrateClamp]) -> None:
    """Find what a sheet's clamp does to it, from forces and dial readings on a flat sheet."""
    pipeline = _pipeline()
    print_issues(clamp_commands.run_calibrate_clamp(request, pipeline.load(request.problem)))


@_command(_infeasible_code)
def next_loop(request: tyro.conf.OmitArgPrefixes[loop_commands.NextLoop]) -> None:
    """Correct the next level of a formed part by the forces that were measured on the levels so far."""
    _pipeline()
    print_issues(loop_commands.run_next_loop(request))


@_command(_infeasible_code)
def simulate_loop(request: tyro.conf.OmitArgPrefixes[loop_commands.SimulateLoop]) -> None:
    """Run the loop that corrects springback against sheets whose truth is known."""
    _pipeline()
    print_issues(loop_commands.run_simulate_loop(request))


@_command(name="scan-fit")
def scan_fit(request: tyro.conf.OmitArgPrefixes[scan_commands.ScanFit]) -> None:
    """Measure a formed part: how far a scan is off the part that a plan was made for."""
    _pipeline()
    print_issues(scan_commands.run_scan_fit(request))


@_command(_infeasible_code)
def adjust(request: tyro.conf.OmitArgPrefixes[scan_commands.Adjust]) -> None:
    """Form a part again: the problem with each target moved by what a scan of the part has shown."""
    _pipeline()
    print_issues(scan_commands.run_adjust(request))


@_command(_failed_code)
def batch(request: tyro.conf.OmitArgPrefixes[batch_commands.Batch]) -> int:
    """Plan many problems, each into a folder of its own, with a summary; exit 0 only if all are verified."""
    _pipeline()
    return batch_commands.run_batch(request)


@_command(_failed_code)
def fit(request: tyro.conf.OmitArgPrefixes[batch_commands.Fit]) -> int:
    """Try a job in several cells, and rank them: which robots for this part."""
    _pipeline()
    return batch_commands.run_fit(request)


@_command(_infeasible_code)
def element(request: tyro.conf.OmitArgPrefixes[element_commands.ElementRequest]) -> None:
    """Divide a building element into panels and write a problem for each."""
    _pipeline()
    print_issues(element_commands.run_element(request))


@_command(name="element-report")
def element_report(request: tyro.conf.OmitArgPrefixes[element_commands.ElementReport]) -> None:
    """Show what became of an element's panels in a batch: `tandem element report OUT RUN` is the same."""
    _pipeline()
    print_issues(element_commands.run_element_report(request))


@_command(name="element-mark")
def element_mark(request: tyro.conf.OmitArgPrefixes[element_commands.ElementMark]) -> None:
    """Keep which panels are cut, glued or broken: `tandem element mark OUT ID cut` is the same."""
    print_issues(element_commands.run_element_mark(request))


@_command()
def compare(request: tyro.conf.OmitArgPrefixes[batch_commands.Compare]) -> None:
    """Show two plans, or two batches, side by side."""
    _pipeline()
    batch_commands.run_compare(request)


@_command()
def serve(request: tyro.conf.OmitArgPrefixes[service_commands.Serve]) -> None:
    """Serve Tandem over HTTP, with a page for browsers."""
    service_commands.serve(request)


@_command()
def token(action: service_commands.Token) -> None:
    """Make, list or revoke the tokens of a service."""
    service_commands.token(action)


@_command()
def audit(request: tyro.conf.OmitArgPrefixes[service_commands.Audit]) -> None:
    """List who did what with the jobs of a service."""
    service_commands.audit(request)


@_command()
def backup(request: tyro.conf.OmitArgPrefixes[service_commands.BackUp]) -> None:
    """Back up the store of a service, which may run meanwhile."""
    service_commands.back_up(request)


@_command()
def restore(request: tyro.conf.OmitArgPrefixes[service_commands.Restore]) -> None:
    """Restore a backup of a service into a new data folder."""
    service_commands.restore(request)


@_command()
def issues() -> None:
    """List every issue code with its meaning, and what a problem may accept."""
    from planner.issue_codes import all_codes

    table = Table("code", "meaning")
    for code, row in all_codes().items():
        may = " (may be accepted)" if row.accepts else ""
        table.add_row(code, row.meaning + may)
    out.print(table)


def main() -> None:
    """Entry point of the command ``tandem``."""
    sys.unraisablehook = _unraisable
    try:
        sys.exit(
            app.cli(
                prog="tandem",
                description="Plan two robots that share one job, and prove their programs.",
                args=_one_word(sys.argv[1:]),
            )
        )
    except Exception as error:
        if _was_stopped(error):
            _stop()
        err.print_exception()
        what = f"{type(error).__name__}: {error}; nothing was written, please report this"
        print_issues((Issue("internal.error", what),))
        sys.exit(FAILED)
    except KeyboardInterrupt:
        _stop()


def _one_word(given: Sequence[str]) -> Sequence[str]:
    """Arguments with ``element report``, ``element mark`` and ``robots add`` as the one command that each
    is."""
    if tuple(given[:2]) in (("element", "report"), ("element", "mark"), ("robots", "add")):
        return [f"{given[0]}-{given[1]}", *given[2:]]
    return given


def _stop() -> NoReturn:
    err.print("stopped; nothing half-written was left")
    sys.exit(130)


def _was_stopped(error: BaseException | None) -> bool:
    """Whether a Ctrl-C is at the root of an error that libraries made of it."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _unraisable(unraisable: sys.UnraisableHookArgs) -> None:
    """A Ctrl-C that meets a callback which cannot raise comes again a moment later."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        threading.Timer(0.05, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(unraisable)


def _pipeline() -> ModuleType:
    """The pipeline, imported when a command needs it: it takes half a second, and Drake, which it imports
    for planning, talks unasked.

    The arrays are small: threads of the linear algebra only get in each other's way, and their number must
    not change a plan. NumPy reads these when it is loaded; who sets them keeps what was set.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with deferred_sigint(), gc_frozen():  # an import that is interrupted may swallow it
        from planner import pipeline

    logging.getLogger("drake").setLevel(logging.WARNING)
    return pipeline


def _processes() -> int:
    """Processes for one plan: two where there are two cores for this one."""
    return min(2, batch_commands.usable_cores())


def _refused(error: TandemError, code: int) -> int:
    print_issues(error.issues)
    return code
