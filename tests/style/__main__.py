"""List or store the counts: see :mod:`tests.style`."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Final

from tests.style import measures

TABLE: Final = Path(__file__).parent / "counts.json"


def main(arguments: list[str]) -> int:
    """Run the command; return 1 if a count rose."""
    parser = argparse.ArgumentParser(prog="python -m tests.style", description=__doc__)
    parser.add_argument(
        "rooms", nargs="*", metavar="ROOM", help="list the findings of a room, e.g. planner/motion"
    )
    parser.add_argument("--write", action="store_true", help="store the counts if none rose")
    options = parser.parse_args(arguments)
    for room in options.rooms:
        for rows in measures.findings()[room].values():
            print("\n".join(rows))
    counted = measures.counts()
    risen = measures.risen(read_stored_counts(), counted)
    print(
        "\n".join(risen) or ", ".join(f"{key} {number}" for key, number in measures.totals(counted).items())
    )
    if options.write and (not risen or not TABLE.exists()):
        TABLE.write_text(json.dumps(counted, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return 1 if risen else 0


def read_stored_counts() -> dict[str, measures.Counts]:
    """Return the stored counts."""
    if not TABLE.exists():
        return {}
    stored: dict[str, measures.Counts] = json.loads(TABLE.read_text(encoding="utf-8"))
    return stored


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
