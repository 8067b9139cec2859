"""Count or write the exceptions of the import contracts: see :mod:`tests.contracts`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import grimp

from tests.contracts.exceptions import CONFIG, find_exceptions, import_graph, read_contracts, write_exceptions


def main(arguments: list[str], config: Path = CONFIG, graph: grimp.ImportGraph | None = None) -> int:
    """Run the command; return 1 if the exceptions do not agree with the imports afterwards."""
    parser = argparse.ArgumentParser(prog="python -m tests.contracts", description=__doc__)
    parser.add_argument("--write", action="store_true", help="remove obsolete exceptions")
    parser.add_argument("--allow-new", action="store_true", help="with --write, add missing exceptions")
    options = parser.parse_args(arguments)
    if options.allow_new and not options.write:
        parser.error("--allow-new requires --write")
    graph = graph or import_graph()
    written: dict[str, frozenset[str]] = {}
    differs = False
    for name, contract in read_contracts(config).items():
        found = find_exceptions(graph, contract)
        added = found.missing if options.allow_new else frozenset()
        written[name] = (found.listed - found.obsolete if options.write else found.listed) | added
        print(f"{name}: {len(written[name])} exceptions")
        for line in sorted(found.obsolete):
            print(f"  {'removed' if options.write else 'obsolete'}: {line}")
        for line in sorted(found.missing):
            print(f"  {'added' if line in added else 'missing'}: {line}")
        differs |= written[name] != found.needed
    print(f"total: {sum(map(len, written.values()))} exceptions")
    if options.write:
        write_exceptions(config, written)
    return int(differs)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
