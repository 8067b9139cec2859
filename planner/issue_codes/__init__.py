"""Table of all issue codes, used by the code, the tests, ``tandem issues`` and the documentation.

A code has the form ``area.problem`` and is stable once released. Each module holds the entries of some areas.
Plug-ins add their own entries (:func:`all_codes`).
"""

from collections.abc import Mapping
from typing import Final

from planner.issue_codes import (
    forming,
    hotwire,
    milling,
    parts,
    problem,
    programs,
    proof,
    results,
    service,
    shopfloor,
    trim,
)
from planner.issue_codes.row import IssueCode

__all__ = ["CODES", "IssueCode", "all_codes", "code_owners", "format_message", "lookup_code"]

CODES: Final[dict[str, IssueCode]] = {
    **problem.CODES,
    **parts.CODES,
    **hotwire.CODES,
    **programs.CODES,
    **proof.CODES,
    **forming.CODES,
    **trim.CODES,
    **milling.CODES,
    **shopfloor.CODES,
    **service.CODES,
    **results.CODES,
}


def all_codes() -> Mapping[str, IssueCode]:
    """Return the entries of Tandem and of all plug-ins, by code; those of Tandem take precedence."""
    out = dict(CODES)
    for entries in _plugin_codes().values():
        out |= {code: entry for code, entry in entries.items() if code not in out}
    return out


def lookup_code(code: str) -> IssueCode:
    """Return the entry of a code.

    Plug-ins are imported only if the code is not one of Tandem's.

    Raises:
        KeyError: Neither Tandem nor a plug-in declares the code.
    """
    entry = CODES.get(code) or all_codes().get(code)
    if entry is None:
        raise KeyError(f"issue code {code!r} is not in planner/issue_codes; declare it there")
    return entry


def format_message(code: str, /, **values: object) -> str:
    """Return the message of an issue from the template of its code.

    Args:
        code: Issue code.
        values: Values of all named fields of the template.

    Raises:
        KeyError: The code is unknown or has no template, or a field has no value.
    """
    template = lookup_code(code).message
    if template is None:
        raise KeyError(f"issue code {code!r} has no message template")
    return template.format_map(values)


def code_owners(code: str) -> frozenset[str]:
    """Return the packages that declare a code: "Tandem", or plug-ins such as "package ring-gauge"."""
    others = {owner for owner, entries in _plugin_codes().items() if code in entries}
    return frozenset({"Tandem", *others} if code in CODES else others)


def _plugin_codes() -> Mapping[str, Mapping[str, IssueCode]]:
    """Return the entries of plug-ins by owner, such as "package ring-gauge", and code.

    Plug-ins whose entries cannot be loaded are skipped here; the registry of processes refuses them.
    """
    from planner.runtime import plugins  # imports importlib.metadata, which `tandem --help` does without

    out: dict[str, dict[str, IssueCode]] = {}
    for kind in (plugins.Process, plugins.Language):
        for name, entries in plugins.loadable(kind, "codes", dict).items():
            out.setdefault(plugins.installed(kind)[name].owner, {}).update(entries)
    return out
