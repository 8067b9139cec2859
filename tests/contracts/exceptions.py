"""Find the imports that break a contract, and write them as exceptions."""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import grimp
from importlinter import api

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / ".importlinter"
WRITE_COMMAND = "python -m tests.contracts --write"

Contract = Mapping[str, str | list[str]]
"""Options of a contract by name, as in ``.importlinter``, and its ``id``."""


class Exceptions(NamedTuple):
    """Exceptions of a contract, as lines of ``ignore_imports``."""

    listed: frozenset[str]
    """Exceptions in ``.importlinter``."""
    needed: frozenset[str]
    """Imports that break the contract and are not intended."""

    @property
    def obsolete(self) -> frozenset[str]:
        """Exceptions without an import."""
        return self.listed - self.needed

    @property
    def missing(self) -> frozenset[str]:
        """Imports that break the current contract."""
        return self.needed - self.listed


@functools.cache
def import_graph() -> grimp.ImportGraph:
    """Read all imports of the package, also inside functions and under ``TYPE_CHECKING``."""
    return grimp.build_graph("planner", cache_dir=None)


def read_contracts(config: Path = CONFIG) -> dict[str, Contract]:
    """Read the contracts by their ids."""
    return {options["id"]: options for options in api.read_configuration(str(config))["contracts_options"]}


def option_lines(contract: Contract, option: str) -> list[str]:
    """Return the lines of an option. A missing option has none."""
    value = contract.get(option, [])
    return [value] if isinstance(value, str) else value


def is_intended(line: str) -> bool:
    """Return whether a line of ``ignore_imports`` is part of the contract, that is, not an exception."""
    return "*" in line


def find_exceptions(graph: grimp.ImportGraph, contract: Contract) -> Exceptions:
    """Compare the exceptions of a contract with the imports that break it."""
    lines = option_lines(contract, "ignore_imports")
    intended = {
        (match["importer"], match["imported"])
        for line in lines
        if is_intended(line)
        for match in graph.find_matching_direct_imports(import_expression=line)
    }
    broken = _upward_imports if contract["type"] == "layers" else _forbidden_imports
    return Exceptions(
        listed=frozenset(line for line in lines if not is_intended(line)),
        needed=frozenset(" -> ".join(pair) for pair in broken(graph, contract) - intended),
    )


def write_exceptions(config: Path, exceptions: Mapping[str, Iterable[str]]) -> None:
    """Replace the exceptions of contracts. Comments and intended imports stay.

    Args:
        config: File to change.
        exceptions: All exceptions of each contract, by its id.
    """
    # A section ends before the next header and the comments directly above it.
    sections = re.split(r"(?m)^(?=(?:#.*\n)*\[)", config.read_text(encoding="utf-8"))
    for number, section in enumerate(sections):
        header = re.search(r"(?m)^\[importlinter:contract:([^]]+)\]$", section)
        if header and header[1] in exceptions:
            sections[number] = _with_exceptions(section, sorted(exceptions[header[1]]))
    config.write_text("".join(sections).rstrip("\n") + "\n", encoding="utf-8")


def _with_exceptions(section: str, exceptions: list[str]) -> str:
    """Return the text of a contract with other exceptions. ``ignore_imports`` is its last option."""
    before, _, after = section.partition("ignore_imports =\n")
    if other := re.search(r"(?m)^\w.*", after):
        raise ValueError(f"ignore_imports must be the last option of a contract (got {other[0]!r} after it)")
    kept = [line for line in after.splitlines() if line.startswith("#") or is_intended(line)]
    lines = [*kept, *(f"    {line}" for line in exceptions)]
    option = ["ignore_imports =", *lines] if lines else []
    return "\n".join([before.rstrip("\n"), *option, "", ""])


def _upward_imports(graph: grimp.ImportGraph, contract: Contract) -> set[tuple[str, str]]:
    """Find the imports that break a contract of the type ``layers``."""
    layers = [
        grimp.Layer(*re.split(r" *[:|] *", line), independent=":" not in line)
        for line in option_lines(contract, "layers")
    ]
    illegal = graph.find_illegal_dependencies_for_layers(
        layers, containers=set(option_lines(contract, "containers"))
    )
    return {
        pair
        for dependency in illegal
        for route in dependency.routes
        if not route.middle
        for pair in itertools.product(route.heads, route.tails)
        if graph.direct_import_exists(importer=pair[0], imported=pair[1])
    }


def _forbidden_imports(graph: grimp.ImportGraph, contract: Contract) -> set[tuple[str, str]]:
    """Find the imports that break a contract of the type ``forbidden``, direct imports alone."""
    sources = _packages(graph, option_lines(contract, "source_modules"))
    forbidden = _packages(graph, option_lines(contract, "forbidden_modules"))
    broken = set()
    for source, target in itertools.product(sources, forbidden):
        if not f"{source}.".startswith(f"{target}.") and not f"{target}.".startswith(f"{source}."):
            importers = {source, *graph.find_descendants(source)}
            imported = {target, *graph.find_descendants(target)}
            broken |= {
                (importer, module)
                for importer in importers
                for module in graph.find_modules_directly_imported_by(importer) & imported
            }
    return broken


def _packages(graph: grimp.ImportGraph, expressions: Iterable[str]) -> set[str]:
    """Find the packages and modules that expressions name."""
    return set().union(*(match_modules(graph, expression) for expression in expressions))


def match_modules(graph: grimp.ImportGraph, expression: str) -> set[str]:
    """Find the packages and modules that an expression with wildcards, or a name, matches."""
    return graph.find_matching_modules(expression) if "*" in expression else {expression} & graph.modules
