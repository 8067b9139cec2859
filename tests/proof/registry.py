"""Tables of faults that are put into texts: each by its name, with the rule that is named for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

Texts = dict[str, str]
Mutator = Callable[[np.random.Generator, Texts], Texts]
Table = dict[str, tuple[str, Mutator]]


def mutator(code: str, *tables: Table) -> Callable[[Mutator], Mutator]:
    """Registers a mutator with the rule that is named for its fault (others may see it first)."""

    def register(function: Mutator) -> Mutator:
        for table in tables:
            table[function.__name__] = (code, function)
        return function

    return register


def into(table: Table) -> Callable[[str], Callable[[Mutator], Mutator]]:
    """:func:`mutator` for a file with one table."""
    return lambda code: mutator(code, table)


def named(table: dict[str, Any]) -> Callable[[Any], Any]:
    """Registers a function under its name alone."""

    def register(function: Any) -> Any:
        table[function.__name__] = function
        return function

    return register


def pick(rng: np.random.Generator, options):
    """One of the options."""
    return options[int(rng.integers(len(options)))]
