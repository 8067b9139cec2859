"""Comparison of programs: whether they differ at most in comments and white space."""

from collections.abc import Mapping

from planner.proof.language_contribution import language_of_file


def is_same_program(first: Mapping[str, str], second: Mapping[str, str]) -> bool:
    """Return whether two sets of programs differ at most in comments and white space, file by file."""
    return first.keys() == second.keys() and all(
        language_of_file(name).same_text(first[name], second[name]) for name in first
    )
