"""Command line: each command of ``tandem`` is a function here; ``main`` is the entry point."""

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
from planner.issues import Issue, Severity, TandemError, accepted_codes, has_errors, is_input_error
from planner.runtime.memory import gc_frozen

DONE, FAILED, BAD_INPUT, NO_PLAN, NOT_PROVEN, NOT_COMPARED = 0, 1, 2, 3, 4, 5
"""Exit codes of the command."""
app = tyro.extras.SubcommandApp()
P = ParamSpec("P")


def _infeasible_code(error: TandemError) -> int:
    """Return the exit code of a command that plans: the input is wrong, or there is no plan."""
    return BAD_INPUT if is_input_error(error.issues) else NO_PLAN


def _failed_code(error: TandemError) -> int:
    """Return the exit code of other commands: the input is wrong, or the command failed."""
    return BAD_INPUT if is_input_error(error.issues) else FAILED


def _command(
    code: Callable[[TandemError], int] = lambda _: BAD_INPUT, name: str | None = None
) -> Callable[[Callable[P, int | None]], Callable[P, int]]:
    """Return a decorator that registers a function as a command.

    The exit code is what the function returns, or `DONE` if it returns None. If it raises ``TandemError``,
    the issues are printed.

    Args:
        code: Function that returns the exit code for a ``TandemError``.
        name: Name of the command, or None for that of the function.
    """

    def register(function: Callable[P, int | None]) -> Callable[P, int]:
        @functools.wraps(function)
        def run(*args: P.args, **kwargs: P.kwargs) -> int:
            try:
                return function(*args, **kwargs) or DONE
            except TandemError as error:
                return _print_refusal(error, code(error))

        app.command(name=name)(run)
        return run

    return register


@_command()
def plan(
    problem: tyro.conf.Positional[Path],
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out"),
    sign: Path | None = None,
    like: Path | None = None,
) -> int:
    """Plan a problem file, prove the programs and write them with a report; exit code 0 only if verified.

    Args:
        problem: the problem file, YAML.
        output: folder for programs, report, replay and plan.
        sign: an OpenSSH Ed25519 key with which the result is signed if it is verified.
        like: the result folder of a similar problem: stock pose, path, approach and retreat are taken over
            where they hold.
    """
    started = time.perf_counter()
    with progress_bar() as progress:
        progress("reading", 0.0)  # show progress before the imports
        pipeline = _import_pipeline()
        try:
            key = None if sign is None else statement.read_private_key(sign)
            pipeline.prepare_output(output, problem)
            reference = None if like is None else pipeline.load_reference_plan(like)
        except TandemError as error:
            return _print_refusal(error, BAD_INPUT)
        try:
            loaded = pipeline.load(problem)
        except TandemError as error:
            pipeline.save_failure(None, error.issues, output)
            return _print_refusal(error, BAD_INPUT)
        progress("reading", 1.0)
        try:
            outcome = pipeline.plan(loaded, progress, _process_count(), reference)
            outcome.save(output, progress)
        except TandemError as error:
            pipeline.save_failure(loaded, error.issues, output)
            return _print_refusal(error, _infeasible_code(error))
    print_issues(outcome.issues)
    print_summary(outcome, output, time.perf_counter() - started)
    if key is not None and not sign_folder(output, loaded, outcome.proof, key):
        return NOT_PROVEN
    return int(pipeline.exit_code(outcome))


@_command()
def check(problem: tyro.conf.Positional[Path]) -> int:
    """Validate a problem file and check reach, without planning."""
    pipeline = _import_pipeline()
    loaded = pipeline.load(problem)
    issues = pipeline.check(loaded)
    print_issues(issues)
    if has_errors(issues):
        return _infeasible_code(TandemError([i for i in issues if i.severity is Severity.ERROR]))
    out.print(f"{loaded.name}: no obstacle to a plan was found")
    print_accepted(accepted_codes(issues))
    return DONE


@_command()
def verify(
    folder: tyro.conf.Positional[Path],
    problem: Path | None = None,
    sign: Path | None = None,
    signed_by: Path | None = None,
) -> int:
    """Prove the programs in a result folder again, from their text and the problem only.

    Args:
        folder: a result folder; only its programs/ and problem/ are read, and proof.json is rewritten. With
            ``problem``, also a folder of programs from another source: what can be read and proven of them is
            reported, and nothing is written.
        problem: your own problem file, to prove against instead of the copy in the folder, and to compare
            that copy with.
        sign: an OpenSSH Ed25519 key with which the result is signed if it is proven.
        signed_by: a public key, or a file of allowed signers, by which the result must be signed.
    """
    pipeline = _import_pipeline()
    key = None if sign is None else statement.read_private_key(sign)
    loaded = pipeline.load_result(folder) if problem is None else pipeline.load(problem)
    signature = () if signed_by is None else statement.check_signed(folder, loaded, signed_by)
    print_issues(compare_with_file(pipeline, folder, loaded, problem))
    print_issues(signature)
    programs = pipeline.read_programs(folder, bare=problem is not None)
    try:
        proof = pipeline.verify(loaded, programs, _process_count())
        is_foreign = problem is not None and not proof.is_read
        partial_reading = pipeline.read_partly(loaded, programs) if is_foreign else None
    except TandemError as error:
        return _print_refusal(error, NOT_PROVEN)
    if partial_reading is not None:
        print_issues(partial_reading.issues)
        out.print(f"{loaded.name}: not read as a whole; proven individually: {partial_reading.proven}")
    else:
        print_issues(proof.issues)
    passed, total, not_applicable = proof.rule_counts
    rules = f"{passed} of {total} rules hold" + (f", {not_applicable} do not apply" if not_applicable else "")
    out.print(f"{loaded.name}: {rules}; {'proven' if proof.ok else 'NOT proven'}")
    print_accepted(loaded.accept)
    if problem is None:
        record_proof(folder, programs, proof, key is not None)
    if key is not None and not sign_folder(folder, loaded, proof, key):
        return NOT_PROVEN
    return DONE if proof.ok and not has_errors(signature) else NOT_PROVEN


@_command()
def report(folders: tyro.conf.Positional[tuple[Path, ...]], maps: bool = False) -> int:
    """Write report and replay into result folders, with a new proof of their programs.

    Args:
        folders: result folders, such as those that ``tandem batch --reports failed`` left without.
        maps: show for each freedom, at some of the targets, where each arm is free, what blocks it elsewhere,
            and the path of the plan.
    """
    _import_pipeline()
    from planner.cli import results

    code = DONE
    for folder in folders:
        try:
            proof = results.write_pages(folder, _process_count(), maps)
        except TandemError as error:
            code = max(code, _print_refusal(error, BAD_INPUT))
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
    """Write cell, part and tool paths of a result folder for CAD programs, or G-code of what was milled.

    CAD files are GLB, or 3DM for Rhino. G-code is for a five-axis machine.

    Args:
        folder: a result folder of ``tandem plan``.
        output: the file, which ends in ``.glb``, ``.3dm`` or ``.ngc``.
        time: the moment that is shown [s], from the plan's first target.
        machine: kinematics of the machine that a ``.ngc`` file is for, as the ``convention`` of G-code files
            states it. Nothing is proven for that machine.
        reverse: letters of its rotary axes that count in the opposite direction, such as those of tables that
            state the tool's motion relative to the table (ISO 841).
    """
    _import_pipeline()
    from planner.cli import results

    written = results.export_result(folder, output, time, machine, reverse)
    out.print(f"written to {written}", highlight=False, markup=False)


@_command(_failed_code)
def upload(request: tyro.conf.OmitArgPrefixes[loading_commands.Upload]) -> int:
    """Send verified programs to a controller, a share or an FTP folder. Nothing is loaded or started.

    Exit code 0 if all data that is read from the controller agrees, 5 if some of it was not compared.
    """
    _import_pipeline()
    sent = loading_commands.run_upload(request)
    return DONE if sent.ready else NOT_COMPARED


@_command(_failed_code)
def download(request: tyro.conf.OmitArgPrefixes[loading_commands.Download]) -> int:
    """Fetch programs back from a controller, list what was touched up there, and prove them again.

    The exit code is that of the proof.
    """
    _import_pipeline()
    touched_up, proof = loading_commands.run_download(request)
    print_issues(loading_commands.summarise_issues(touched_up))
    print_issues(proof.issues)
    change_text = f"touched up in {len(touched_up)} places" if touched_up else "unchanged since it was sent"
    out.print(f"{change_text}; {'proven' if proof.ok else 'NOT proven'}", highlight=False)
    out.print("These are stored files; loaded modules were not read: save them first.", highlight=False)
    return DONE if proof.ok else NOT_PROVEN


@_command()
def robots(name: tyro.conf.Positional[str | None] = None) -> None:
    """List the built-in robots, or show one of them with the sources of its figures.

    Args:
        name: the robot to show.
    """
    robot_commands.show_robots(name)


@_command(name="robots-add")
def robots_add(request: tyro.conf.OmitArgPrefixes[robot_commands.AddRobot]) -> None:
    """Check the URDF of your own arm and write it for a cell; `tandem robots add` is the same command."""
    robot_commands.run_add(request)


@_command()
def materials() -> None:
    """List the materials of wires, foams and sheets, each figure with its value and source."""
    from planner.catalogue import materials

    table = Table("name", "material", "figure", "value", "source")
    for name, title, figure, value, source in [*materials.figures(), *materials.sheet_metal_figures()]:
        table.add_row(name, title, figure.replace("_", " "), value, source)
    out.print(table)


@_command()
def kerf(action: preparation_commands.KerfAction) -> None:
    """Fit a foam of your own from test cuts, or compute a kerf, a speed or a power."""
    preparation_commands.run_kerf(action)


@_command()
def align(request: tyro.conf.OmitArgPrefixes[preparation_commands.Align]) -> None:
    """Find the base of a cell's second robot from points that both robots probed."""
    print_issues(preparation_commands.run_align(request))


@_command()
def features(request: tyro.conf.OmitArgPrefixes[preparation_commands.Features]) -> None:
    """Show the features of a sheet part as a tree, in forming order, and draw them."""
    print_issues(preparation_commands.run_features(request))


@_command(_infeasible_code)
def springback(request: tyro.conf.OmitArgPrefixes[forming_commands.SpringbackCommand]) -> None:
    """Predict the springback of a formed part before it is formed."""
    pipeline = _import_pipeline()
    print_issues(forming_commands.run_springback(request, pipeline.load(request.problem)))


@_command(_infeasible_code)
def control(request: tyro.conf.OmitArgPrefixes[forming_commands.ControlRequest]) -> None:
    """Compute gains of force control and compensation for a measured machine, and simulate them."""
    pipeline = _import_pipeline()
    print_issues(forming_commands.run_control(request, pipeline.load(request.problem)))


@_command(_infeasible_code, name="calibrate-clamp")
def calibrate_clamp(request: tyro.conf.OmitArgPrefixes[clamp_commands.CalibrateClamp]) -> None:
    """Find the effect of a clamp on its sheet, from forces and dial readings on a flat sheet."""
    pipeline = _import_pipeline()
    print_issues(clamp_commands.run_calibrate_clamp(request, pipeline.load(request.problem)))


@_command(_infeasible_code)
def next_loop(request: tyro.conf.OmitArgPrefixes[loop_commands.NextLoop]) -> None:
    """Correct the next level of a formed part by the forces that were measured on the levels so far."""
    _import_pipeline()
    print_issues(loop_commands.run_next_loop(request))


@_command(_infeasible_code)
def simulate_loop(request: tyro.conf.OmitArgPrefixes[loop_commands.SimulateLoop]) -> None:
    """Run the springback correction loop on sheets with known properties."""
    _import_pipeline()
    print_issues(loop_commands.run_simulate_loop(request))


@_command(name="scan-fit")
def scan_fit(request: tyro.conf.OmitArgPrefixes[scan_commands.ScanFit]) -> None:
    """Measure a formed part: the deviation of a scan from the planned part."""
    _import_pipeline()
    print_issues(scan_commands.run_scan_fit(request))


@_command(_infeasible_code)
def adjust(request: tyro.conf.OmitArgPrefixes[scan_commands.Adjust]) -> None:
    """Form a part again: write the problem with each target moved by the deviation that a scan shows."""
    _import_pipeline()
    print_issues(scan_commands.run_adjust(request))


@_command(_failed_code)
def batch(request: tyro.conf.OmitArgPrefixes[batch_commands.Batch]) -> int:
    """Plan many problems, each into its own folder, with a summary; exit code 0 only if all are verified."""
    _import_pipeline()
    return batch_commands.run_batch(request)


@_command(_failed_code)
def fit(request: tyro.conf.OmitArgPrefixes[batch_commands.Fit]) -> int:
    """Try a job in several cells and rank them, to find robots for a part."""
    _import_pipeline()
    return batch_commands.run_fit(request)


@_command(_infeasible_code)
def element(request: tyro.conf.OmitArgPrefixes[element_commands.ElementRequest]) -> None:
    """Divide a building element into panels and write a problem for each."""
    _import_pipeline()
    print_issues(element_commands.run_element(request))


@_command(name="element-report")
def element_report(request: tyro.conf.OmitArgPrefixes[element_commands.ElementReport]) -> None:
    """Show the results of an element's panels in a batch.

    `tandem element report OUT RUN` is the same command.
    """
    _import_pipeline()
    print_issues(element_commands.run_element_report(request))


@_command(name="element-mark")
def element_mark(request: tyro.conf.OmitArgPrefixes[element_commands.ElementMark]) -> None:
    """Record which panels are cut, glued or broken; `tandem element mark OUT ID cut` is the same command."""
    print_issues(element_commands.run_element_mark(request))


@_command()
def compare(request: tyro.conf.OmitArgPrefixes[batch_commands.Compare]) -> None:
    """Show two plans, or two batches, side by side."""
    _import_pipeline()
    batch_commands.run_compare(request)


@_command()
def serve(request: tyro.conf.OmitArgPrefixes[service_commands.Serve]) -> None:
    """Serve Tandem over HTTP, with a page for browsers."""
    service_commands.serve(request)


@_command()
def token(action: service_commands.Token) -> None:
    """Create, list or revoke the tokens of a service."""
    service_commands.token(action)


@_command()
def audit(request: tyro.conf.OmitArgPrefixes[service_commands.Audit]) -> None:
    """List who did what with the jobs of a service."""
    service_commands.audit(request)


@_command()
def backup(request: tyro.conf.OmitArgPrefixes[service_commands.BackUp]) -> None:
    """Back up the store of a service, which may keep running."""
    service_commands.back_up(request)


@_command()
def restore(request: tyro.conf.OmitArgPrefixes[service_commands.Restore]) -> None:
    """Restore a backup of a service into a new data folder."""
    service_commands.restore(request)


@_command()
def issues() -> None:
    """List every issue code with its meaning, and which ones a problem may accept."""
    from planner.issue_codes import all_codes

    table = Table("code", "meaning")
    for code, entry in all_codes().items():
        remark = " (may be accepted)" if entry.acceptance else ""
        table.add_row(code, entry.meaning + remark)
    out.print(table)


def main() -> None:
    """Entry point of the command ``tandem``."""
    sys.unraisablehook = _handle_unraisable
    try:
        sys.exit(
            app.cli(
                prog="tandem",
                description="Plan two robots that share one job, and prove their programs.",
                args=_join_subcommand(sys.argv[1:]),
            )
        )
    except Exception as error:
        if _is_interrupt(error):
            _exit_stopped()
        err.print_exception()
        message = f"{type(error).__name__}: {error}; nothing was written, please report this"
        print_issues((Issue("internal.error", message),))
        sys.exit(FAILED)
    except KeyboardInterrupt:
        _exit_stopped()


def _join_subcommand(arguments: Sequence[str]) -> Sequence[str]:
    """Join ``element report``, ``element mark`` and ``robots add`` into one command name each."""
    if tuple(arguments[:2]) in (("element", "report"), ("element", "mark"), ("robots", "add")):
        return [f"{arguments[0]}-{arguments[1]}", *arguments[2:]]
    return arguments


def _exit_stopped() -> NoReturn:
    err.print("stopped; no partial files were left")
    sys.exit(130)


def _is_interrupt(error: BaseException | None) -> bool:
    """Report whether a Ctrl-C is a cause of an error that a library raised."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _handle_unraisable(unraisable: sys.UnraisableHookArgs) -> None:
    """Raise a Ctrl-C again if it was raised in a callback that cannot pass exceptions on.

    Python reports such exceptions to this hook and drops them. The interruption is repeated 0.05 s later.
    """
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        threading.Timer(0.05, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(unraisable)


def _import_pipeline() -> ModuleType:
    """Import the pipeline when a command needs it, which takes half a second.

    The import loads Drake, whose log level is raised to show warnings only. The linear algebra uses one
    thread, because the arrays are small and the number of threads must not change a plan. NumPy reads these
    environment variables when it is loaded. Values that are set already are kept.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with deferred_sigint(), gc_frozen():  # an interrupted import may lose the signal
        from planner import pipeline

    logging.getLogger("drake").setLevel(logging.WARNING)
    return pipeline


def _process_count() -> int:
    """Return the number of processes for one plan: two if this process may use two cores."""
    return min(2, batch_commands.usable_cores())


def _print_refusal(error: TandemError, code: int) -> int:
    print_issues(error.issues)
    return code
