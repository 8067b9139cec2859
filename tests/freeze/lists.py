"""The order of proof rules and the modules that start-up imports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Final

from tests.freeze.digests import ROOT

RULE_CODES_FILE: Final = Path(__file__).parent / "rule_codes.txt"
IMPORTS_FILE: Final = Path(__file__).parent / "startup_imports.py"
STARTS: Final = {
    "import planner": "import planner",
    "tandem --help": "sys.argv = ['tandem', '--help']; from planner.__main__ import main; main()",
    "load a problem": "from planner import pipeline; pipeline.load('gauge_lanes')",
}
"""Code of each way to start, by name."""


def rule_codes() -> list[str]:
    """Return the codes of the proof rules in the order in which they run."""
    from planner.proof.rule_table import built_in

    return list(built_in())


def write_rule_codes() -> None:
    """Store the codes of the proof rules, one per line."""
    RULE_CODES_FILE.write_text("\n".join(rule_codes()) + "\n", "utf-8")


def imports(start: str) -> dict[str, list[str]]:
    """Return what a fresh process imports for one of :data:`STARTS`.

    Returns:
        ``modules``: the planner's modules; ``packages``: third-party top-level packages, without private ones
        and those that every process of this Python imports.
    """
    usual = {name.partition(".")[0] for name in _modules_of("pass")} | sys.stdlib_module_names
    found = _modules_of(STARTS[start])
    modules = [name for name in found if name.partition(".")[0] == "planner"]
    packages = {name.partition(".")[0] for name in found} - usual - {"planner", "cython_runtime"}
    return {
        "modules": sorted(modules),
        "packages": sorted(one for one in packages if not one.startswith("_")),
    }


def write_imports() -> None:
    """Store what start-up imports, one quoted name per line."""
    lines = [
        '"""Modules that start-up imports; written by ``python -m tests.freeze --write imports``."""',
        "",
        "IMPORTS = {",
    ]
    for start in STARTS:
        lines.append(f'    "{start}": {{')
        for kind, names in imports(start).items():
            inside = [f'            "{name}",' for name in names]
            lines += [f'        "{kind}": [', *inside, "        ],"] if names else [f'        "{kind}": [],']
        lines.append("    },")
    IMPORTS_FILE.write_text("\n".join([*lines, "}", ""]), "utf-8")


def _modules_of(code: str) -> list[str]:
    """Return the modules that a process has imported when it ends."""
    report = "import atexit, sys; atexit.register(lambda: print(*sys.modules, file=sys.stderr))"
    done = subprocess.run(
        [sys.executable, "-c", f"{report}; {code}"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stderr.splitlines()[-1].split()
