"""Comparison of programs: whether they differ in comments and white space at most."""

from collections.abc import Mapping

from planner.proof.language_contribution import of_file


def same_program(first: Mapping[str, str], second: Mapping[str, str]) -> bool:
    """Whether two sets of programs differ in comments and white space at most, file by file."""
    return first.keys() == second.keys() and all(
        of_file(name).same_text(first[name], second[name]) for name in first
    )
