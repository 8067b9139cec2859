"""``python -m bench [name ...]``: run measurements, print one table, write ``bench/results/<name>.json``.

``python -m bench corpus --help``: ordinary jobs, and what becomes of them; ``python -m bench peers --help``:
all rows beside other tools in one table. Neither is among the measurements that run by default.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bench.machine import machine

SUFFIX = "_bench"


def names() -> list[str]:
    """The measurements there are: modules of this package that end in ``_bench``."""
    result = (module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)]))
    return sorted(name.removesuffix(SUFFIX) for name in result if name.endswith(SUFFIX))


def main(arguments: list[str]) -> int:
    """Run the named measurements, all by default, the corpus or the peers; returns 2 for an unknown name."""
    if arguments[:1] == ["corpus"]:
        from bench.corpus import command

        return command.main(arguments[1:])
    if arguments[:1] == ["peers"]:
        from bench import peers

        return peers.main(arguments[1:])
    chosen = arguments or names()
    unknown = sorted(set(chosen) - set(names()))
    if unknown:
        print(f"unknown measurement {', '.join(unknown)}; there are {', '.join(names())}", file=sys.stderr)
        return 2
    table = Table("measurement", "median", "p99", "spread", "ratio to peer", "note")
    results = Path(__file__).parent / "results"
    results.mkdir(exist_ok=True)
    for name in chosen:
        rows: list[dict[str, Any]] = importlib.import_module(f"bench.{name}{SUFFIX}").run()
        for row in rows:
            table.add_row(
                *(_cell(row.get(key)) for key in ("name", "median_s", "p99_s", "spread", "ratio", "note"))
            )
        data = {"machine": machine(), "rows": rows}
        (results / f"{name}.json").write_text(json.dumps(data, indent=1) + "\n")
    Console(width=160).print(table)
    return 0


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else escape(str(value))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
