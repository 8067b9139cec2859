"""Row of the table of issue codes."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class IssueCode:
    """One row of the table of issue codes.

    An issue can only be accepted if the user may know better than Tandem: forces, metals, supports of blocks.
    Issues that make a motion wrong (collisions, limits, unstable wires, slot widths) can never be accepted.

    Attributes:
        meaning: What the code means, as a phrase without a full stop.
        is_input_error: Whether the input is at fault (exit code 2) rather than the motion (exit code 3).
        acceptance: What a problem accepts if it lists the code under ``accept``. None if it must not list it.
        remedy: Remedy for issues that state none of their own.
        message: Template of the message with named fields, as for :meth:`str.format`. None if its wording
            depends on values, or if several places in the code have messages of their own.
    """

    meaning: str
    is_input_error: bool = False
    acceptance: str | None = None
    remedy: str | None = None
    message: str | None = None
