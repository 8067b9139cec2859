"""Write the stored digests and lists anew: see :mod:`tests.freeze`."""

from __future__ import annotations

import argparse
import json
import resource
import sys

from tests.freeze import digests

LISTS = ("rules", "imports")


def main(arguments: list[str]) -> int:
    """Run the command; return 2 for a request that cannot be met."""
    parser = argparse.ArgumentParser(prog="python -m tests.freeze", description=__doc__)
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument(
        "--write", nargs="*", metavar="NAME", help="problems, 'rules', 'imports'; default: all"
    )
    action.add_argument("--plan", metavar="NAME", help="plan one problem here and print its digests as JSON")
    parser.add_argument("--resume", action="store_true", help="skip problems that the table has")
    options = parser.parse_args(arguments)
    if options.plan is not None:
        print(json.dumps(digests.plan(options.plan)))
        return 0
    return _write(options.write, options.resume)


def _write(names: list[str], resume: bool) -> int:
    from planner.service import bundled_examples
    from tests.freeze import lists

    known = sorted(bundled_examples.problems())
    if unknown := set(names) - {*known, *LISTS}:
        print(f"unknown: {', '.join(sorted(unknown))}; known: {', '.join([*LISTS, *known])}", file=sys.stderr)
        return 2
    if not names or "rules" in names:
        lists.write_rule_codes()
    if not names or "imports" in names:
        lists.write_imports()
    chosen = [name for name in names if name not in LISTS] if names else known
    keep = resume or bool(names)
    table = digests.read_table() if keep and digests.TABLE.exists() else {}
    recorded_with, problems = table.get("environment", digests.environment()), table.get("problems", {})
    if mismatch := digests.environment_mismatch(recorded_with):
        print(f"write all digests: this machine has {mismatch}", file=sys.stderr)
        return 2
    for name in chosen:
        if resume and name in problems:
            continue
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        problems[name] = digests.compute(name)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(f"{name}: {len(problems[name])} digests, {seconds:.1f} s of processor time", flush=True)
        digests.write_table(recorded_with, problems)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
