"""Variants of the gauge that cannot be used."""

from __future__ import annotations

import dataclasses
from typing import Any, Final, Literal

from planner.issue_codes import IssueCode
from planner.proof.contribution import ProofOfProcess
from planner.reading.strict_yaml import Name, Strict
from planner.runtime.plugins import Process
from tests.toys.gauge import PROCESS
from tests.toys.gauge.codes import CODES
from tests.toys.gauge.proof import above

MODULE: Final = "tests.toys.variants"


def _variant(**members: Any) -> Process:
    return dataclasses.replace(PROCESS, **members)


class Unfinished(Strict):
    """An operation that lacks what every one has."""

    name: Name
    process: Literal["ring"]


class NoClaim:
    """A class that does not inherit from Claim."""


NO_CLAIMS: Final = (NoClaim,)
COPIED: Final = dict(CODES)
OF_TANDEM: Final = {**CODES, "verify.reach": IssueCode("a code of Tandem")}
MEANINGS: Final = {"ring.above": "a gauge is too low"}

UNFINISHED: Final = _variant(schema=f"{MODULE}:Unfinished")
NO_KIND: Final = _variant(claims=f"{MODULE}:NO_CLAIMS")
MISSING_CODES: Final = _variant(codes=f"{MODULE}:NOTHING")
DUPLICATE_CODES: Final = _variant(codes=f"{MODULE}:COPIED")
TANDEMS_CODE: Final = _variant(codes=f"{MODULE}:OF_TANDEM")
NO_ROWS: Final = _variant(codes=f"{MODULE}:MEANINGS")

UNPROVEN: Final = _variant(proof=None)
NO_PROOF: Final = _variant(proof="no_such_module_at_all:PROOF")
NO_REPORT: Final = _variant(report=f"{MODULE}:NO_CLAIMS")

BARE: Final = ProofOfProcess((dataclasses.replace(above, code="ring.bare"),))
TWICE: Final = ProofOfProcess((dataclasses.replace(above, code="verify.follows"),))
BORROWED: Final = ProofOfProcess((dataclasses.replace(above, code="verify.unread"),))
SOMEDAY: Final = ProofOfProcess((dataclasses.replace(above, stage="someday"),))  # type: ignore[arg-type]
BARE_RULE: Final = _variant(proof=f"{MODULE}:BARE")
SECOND_RULE: Final = _variant(proof=f"{MODULE}:TWICE")
BORROWED_CODE: Final = _variant(proof=f"{MODULE}:BORROWED")
NO_STAGE: Final = _variant(proof=f"{MODULE}:SOMEDAY")
