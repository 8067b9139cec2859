"""SHA-256 digests of everything that planning a bundled problem writes.

Planning is deterministic: result folders of two runs are identical, whatever the folder, the time, the hash
seed and the number of processes. A file with words has two rows: one of all bytes, and one ``without words``
(:mod:`tests.freeze.wordless`), which a change of wording does not affect. Two values that do not describe
behaviour are fixed while digests are computed (:func:`plan`): the version of Tandem, which is in every
program header, and the patch level of Python, which ``plan.json`` and ``report.html`` state.

Floating-point results depend on the kernels that OpenBLAS and NumPy choose for the processor.
:data:`PINNED_KERNELS` fixes them in the process that plans. Files whose digests differ from those with pinned
kernels, measured on an AMD EPYC (Zen 3, no AVX-512) with the versions in ``digests.json``:

| changed setting | gauge_lanes | kerf_test | engrave |
|---|---|---|---|
| ``OPENBLAS_CORETYPE=Zen``, which OpenBLAS chooses there | 0 of 13 | 0 of 17 | 0 of 14 |
| ``OPENBLAS_CORETYPE=Sandybridge`` (AVX without FMA) | 10 of 13 | 7 of 17 | 8 of 14 |
| NumPy without AVX2 kernels (``X86_V3`` disabled) | 0 of 13 | 1 of 17 | 0 of 14 |
| two threads | 0 of 13 | not measured | not measured |

Kernels for AVX-512 (``SkylakeX``, ``X86_V4``) were not measured, as that processor has none.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from tests.freeze import wordless

ROOT: Final = Path(__file__).parents[2]
TABLE: Final = Path(__file__).parent / "digests.json"
PACKAGES: Final = ("drake", "numpy", "scipy", "toppra", "shapely", "trimesh", "pillow")
"""Distributions whose versions may change the last bits of results. Pillow compresses pictures of reports."""
PINNED_KERNELS: Final = {
    "OPENBLAS_CORETYPE": "Haswell",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
}
"""Environment variables that select AVX2 kernels and one thread, on every processor with AVX2 and FMA."""
WRITE_COMMAND: Final = "python -m tests.freeze --write"

Digests = dict[str, str]
"""SHA-256 in hex by file name."""


def environment() -> dict[str, str]:
    """Return the architecture and the versions that results depend on beyond the planner's code."""
    libc, libc_version = platform.libc_ver()
    return {
        "machine": platform.machine(),
        "python": ".".join(platform.python_version_tuple()[:2]),
        libc or "libc": libc_version,
        "zlib": zlib.ZLIB_RUNTIME_VERSION,
        **{name: importlib.metadata.version(name) for name in PACKAGES},
    }


def read_table() -> dict[str, Any]:
    """Return the stored table: ``environment``, and ``problems`` with their digests by name."""
    table: dict[str, Any] = json.loads(TABLE.read_text("utf-8"))
    return table


def write_table(recorded_with: Mapping[str, str], problems: Mapping[str, Digests]) -> None:
    """Write the table, one line per file."""
    table = {"environment": recorded_with, "problems": dict(sorted(problems.items()))}
    TABLE.write_text(json.dumps(table, indent=1) + "\n", "utf-8")


def environment_mismatch(recorded_with: Mapping[str, str]) -> str:
    """Return how this machine differs from the one that recorded the table, or an empty string."""
    current = environment()
    different = [
        f"{name} {current.get(name, 'missing')} (recorded with {recorded_with.get(name, 'none')})"
        for name in sorted({*current, *recorded_with})
        if current.get(name) != recorded_with.get(name)
    ]
    return ", ".join(different)


def differences(recorded: Digests, current: Digests) -> list[str]:
    """Return one line for each file that was added, removed or changed."""
    kinds = {
        "removed": [name for name in recorded if name not in current],
        "added": [name for name in current if name not in recorded],
        "changed": [name for name in recorded if name in current and recorded[name] != current[name]],
    }
    return [f"{kind}: {name}" for kind, names in kinds.items() for name in names]


def compute(name: str, kernels: Mapping[str, str] = PINNED_KERNELS) -> Digests:
    """Plan a bundled problem in a process with pinned kernels and return the digests of its results.

    Raises:
        RuntimeError: If the process fails.
    """
    command = [sys.executable, "-m", "tests.freeze", "--plan", name]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, **kernels}, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{name}: planning failed.\n{done.stderr}")
    digests: Digests = json.loads(done.stdout)
    return digests


def plan(name: str) -> Digests:
    """Plan a bundled problem in this process and return the digests of its results.

    A problem that is refused has the digests of its report and of its issues. The entry ``issues without
    text`` changes only with codes, fields, values and limits, and not with the wording of messages.
    """
    python_version, version = platform.python_version(), importlib.metadata.version
    fixed = ".".join(python_version.split(".")[:2]) + ".0"
    platform.python_version = lambda: fixed
    importlib.metadata.version = lambda package: "0.0.0" if package == "tandem-planner" else version(package)
    from planner.runtime import version as own

    own.__dict__["__version__"] = "0.0.0"  # before any other module of the package reads it
    from planner import pipeline
    from planner.issues import TandemError

    problem = None
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(ROOT):
        try:
            problem = pipeline.load(_problem_file(name))
            pipeline.plan(problem).save(folder)
        except TandemError as error:
            pipeline.save_failure(problem, error.issues, folder)
            return {**_folder_digests(Path(folder)), **_issue_digests([i.to_dict() for i in error.issues])}
        return _folder_digests(Path(folder))


def _problem_file(name: str) -> str:
    """Return the path of a bundled problem from the root, so that no absolute path gets into results."""
    folder, _, stem = name.partition("/")
    return f"problems/{folder}/{stem or 'problem'}.yaml"


def _folder_digests(folder: Path) -> Digests:
    out: Digests = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name, content = path.relative_to(folder).as_posix(), path.read_bytes()
        out[name] = _sha256(content)
        if wordless.has_words(name):
            out[f"{name} without words"] = wordless.digest(name, content)
    return out


def _issue_digests(issues: list[dict[str, Any]]) -> Digests:
    text = {"message", "hint", "remedy"}
    bare = [{key: value for key, value in issue.items() if key not in text} for issue in issues]
    encode = json.JSONEncoder(sort_keys=True, default=str).encode
    return {"issues": _sha256(encode(issues).encode()), "issues without text": _sha256(encode(bare).encode())}


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
