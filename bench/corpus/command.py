"""``python -m bench corpus``: run jobs of the corpus and print what became of them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from bench import corpus
from bench.corpus import remedies, run, table
from bench.corpus.job import Job


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    own = argparse.ArgumentParser(prog="python -m bench corpus", description=corpus.__doc__)
    own.add_argument("--only", nargs="*", default=[], help="families, such as wing, or jobs, such as wing_03")
    own.add_argument("--count", type=int, help="so many jobs, of all families in turn")
    own.add_argument(
        "--folder", type=Path, default=Path("out/corpus"), help="of jobs and results; goes on there"
    )
    own.add_argument("--processes", type=int, default=2)
    own.add_argument("--limit", type=int, default=run.LIMIT, help="processor seconds of a job's plan")
    own.add_argument("--write", action="store_true", help="only write the jobs, for tandem plan")
    own.add_argument("--list", action="store_true", help="only list the jobs and what is to become of them")
    own.add_argument("--done", action="store_true", help="only the table of what has run")
    own.add_argument("--remedies", action="store_true", help="then do what refusals advise, and plan again")
    own.add_argument("--table", type=Path, help="also write the table into this file, Markdown")
    return own


def chosen(only: Sequence[str], count: int | None) -> list[Job]:
    """Return the requested jobs in the order of the corpus.

    Raises:
        SystemExit: A name is unknown.
    """
    unknown = sorted(set(only) - {*corpus.FAMILIES, *corpus.names()})
    if unknown:
        raise SystemExit(f"unknown: {', '.join(unknown)}; families are {', '.join(corpus.FAMILIES)}")
    return [corpus.find(name) for name in corpus.names(only)[:count]]


def main(arguments: Sequence[str]) -> int:
    """Run the command; 1 where a job crashed or ended not proven."""
    own = parser().parse_args(arguments)
    jobs = chosen(own.select, own.count)
    if own.list:
        for job in jobs:
            what = "feasible" if job.feasible else " or ".join(sorted(job.codes))
            print(f"{job.name:12} {what:40} {job.why}")
        return 0
    if own.write:
        for job in jobs:
            print(job.write(own.folder))
        return 0
    results = run.done(jobs, own.folder) if own.done else run.run(jobs, own.folder, own.processes, own.limit)
    text = table.markdown(results)
    if own.remedies:
        refused = [r for r in results if r.verdict in (run.FALSE, run.TRUE, run.OTHER)]
        text += "\n" + remedies.markdown([(r, remedies.follow(r, own.folder, own.limit)) for r in refused])
    print(text)
    if own.table is not None:
        own.table.write_text(text)
    return int(any(result.verdict in (run.UNPROVEN, run.CRASH) for result in results))
