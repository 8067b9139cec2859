"""Steps of ``tandem verify`` around the proof: compare problems, record the proof, sign the result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Final

from planner.cli import statement
from planner.cli.batch import Difference, differences
from planner.cli.console import out, print_issues
from planner.issues import Issue, Severity, TandemError

if TYPE_CHECKING:
    from planner.problem import Problem
    from planner.proof.verdict import Proof

MAX_FIELDS_SHOWN: Final = 40
"""Maximum number of differing fields that are listed."""


def compare_with_file(
    pipeline: ModuleType, folder: Path, problem: Problem, file: Path | None
) -> tuple[Issue, ...]:
    """Print how the problem stored in a result folder differs from the user's own.

    Args:
        pipeline: Module :mod:`planner.pipeline`, which the caller has imported.
        folder: Result folder.
        problem: The user's own problem, or that of the folder if ``file`` is None.
        file: File of the user's own problem, or None to compare nothing.

    Returns:
        A warning if they differ, or if the stored problem cannot be read.
    """
    if file is None:
        out.print(f"problem in {folder}: {problem.digest}", highlight=False, markup=False, soft_wrap=True)
        out.print("It was not compared with your own file: use --problem FILE.", highlight=False)
        return ()
    if not (folder / "problem").exists():
        return ()  # a folder of programs alone
    try:
        stored = pipeline.load_result(folder)
    except TandemError as error:
        message = f"the problem in {folder} cannot be read: {error.issues[0].message}"
        hint = "the proof is against your file; plan it into its own folder to have its copy there"
        return (Issue("verify.problem_differs", message, Severity.WARNING, file=str(folder), hint=hint),)
    out.print(f"problem in {folder}: {stored.digest}", highlight=False, markup=False, soft_wrap=True)
    out.print(f"problem in {file}: {problem.digest}", highlight=False, markup=False, soft_wrap=True)
    if stored.digest == problem.digest:
        out.print("They are the same, values and files.", highlight=False)
        return ()
    differing = differences(stored.source, problem.source)
    _print_differences(differing, folder, file)
    message = f"the problem in {folder} differs from {file} in {len(differing)} fields"
    hint = f"the proof is against your file; plan {file} yourself, or ask why the folder has another problem"
    return (Issue("verify.problem_differs", message, Severity.WARNING, file=str(folder), hint=hint),)


def _print_differences(differing_fields: tuple[Difference, ...], folder: Path, file: Path) -> None:
    for difference in differing_fields[:MAX_FIELDS_SHOWN]:
        text = f"  {difference.field}: {difference.first} in {folder}, {difference.second} in {file}"
        out.print(text, highlight=False, markup=False, soft_wrap=True)
    if len(differing_fields) > MAX_FIELDS_SHOWN:
        out.print(f"  and {len(differing_fields) - MAX_FIELDS_SHOWN} more fields", highlight=False)


def record_proof(folder: Path, programs: Mapping[str, str], proof: Proof, signed: bool) -> None:
    """Write ``proof.json`` into a result folder, unless the one there is signed and will not be signed again.

    Args:
        folder: Result folder.
        programs: Text of the programs, by name.
        proof: Proof of the programs.
        signed: The result is signed again afterwards.
    """
    from planner.shopfloor.loading import proven

    try:
        if not proven.record(folder, programs, proof, signed):
            out.print("proof.json is signed and stays as it is; --sign rewrites it", highlight=False)
    except (OSError, TandemError) as error:
        out.print(f"proof.json is not written ({error})", highlight=False, markup=False, soft_wrap=True)


def sign_folder(folder: Path, problem: Problem, proof: Proof, key: statement.PrivateKey) -> bool:
    """Sign a result folder and print the fingerprint of the key.

    Returns:
        False if it cannot be signed. The issues are printed.
    """
    from planner import pipeline

    try:
        stored = pipeline.load_result(folder).digest
        out.print(f"signed by {statement.sign_result(folder, problem, stored, proof, key)}", highlight=False)
    except TandemError as error:
        print_issues(error.issues)
        return False
    return True
