"""Issue codes of result folders: plans, claims, reports, signatures, and internal errors."""

from typing import Final

from planner.issue_codes.row import IssueCode

CODES: Final[dict[str, IssueCode]] = {
    # saved plans
    "output.folder": IssueCode(
        "the output folder is not writable, or contains the problem file itself", is_input_error=True
    ),
    "output.disk_full": IssueCode(
        "the disk of the output folder is full",
        message="the disk for results is full, so nothing was written; free space on it and plan again",
    ),
    "plan.missing_file": IssueCode("a file of a saved plan is missing or unreadable"),
    "plan.damaged": IssueCode("a file of a saved plan is damaged"),
    "plan.schema": IssueCode("a saved plan has another format or schema version"),
    "plan.not_saveable": IssueCode(
        "a plan contains a value that is neither an array nor plain data",
        message="value {field} of the plan is {kind}; a plan holds arrays, tuples, lists, mappings, text, "
        "numbers and Tandem's own values",
    ),
    # report
    "report.exhibit": IssueCode(
        "an exhibit of a process has an invalid form and is left out of the report",
        message="exhibit {name!r} of kind {kind!r}: cannot be drawn: {error_type}: {error} (allowed kinds "
        "{allowed_kinds})",
    ),
    "sign.extra": IssueCode(
        "signatures require a package that is not installed",
        message="signatures need the package cryptography: {install_command}",
    ),
    "sign.key": IssueCode("the key file for signatures is unusable", message="key file {path} {fault}"),
    "sign.unproven": IssueCode(
        "only a proven result can be signed", message="{folder} is not signed, because {reason}"
    ),
    "sign.missing": IssueCode("the result is not signed"),
    "sign.signature": IssueCode("the signature was not made with the given keys, or not for this text"),
    "sign.content": IssueCode("the result differs from the signed one"),
    "sign.good": IssueCode("the result is signed and unchanged"),
    "claims.unproven": IssueCode(
        "a claim of a process is checked by no proof rule",
        message="{operation}: its process claims {claim_type}, which no rule of the proof checks; add a "
        "rule for it, or claim only what rules prove",
    ),
    "claims.none": IssueCode("a process makes no claim about an operation"),
    # internal
    "internal.error": IssueCode("internal error of Tandem; nothing was written"),
}
