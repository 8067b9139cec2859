"""Tables of text faults by name, each with the rule that has to catch it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

Texts = dict[str, str]
Mutator = Callable[[np.random.Generator, Texts], Texts]
Table = dict[str, tuple[str, Mutator]]


def mutator(code: str, *tables: Table) -> Callable[[Mutator], Mutator]:
    """Register a mutator with the rule for its fault. Other rules may report the fault first."""

    def register(function: Mutator) -> Mutator:
        for table in tables:
            table[function.__name__] = (code, function)
        return function

    return register


def into(table: Table) -> Callable[[str], Callable[[Mutator], Mutator]]:
    """Return :func:`mutator` for a file with one table."""
    return lambda code: mutator(code, table)


def named(table: dict[str, Any]) -> Callable[[Any], Any]:
    """Register a function under its name alone."""

    def register(function: Any) -> Any:
        table[function.__name__] = function
        return function

    return register


def pick(rng: np.random.Generator, options):
    """Return a random item of the options."""
    return options[int(rng.integers(len(options)))]
