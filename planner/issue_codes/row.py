"""Row of the table of issue codes."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class IssueCode:
    """One row of the table of issue codes.

    Issues may only be accepted where the user may know better than Tandem: forces, metals, supports of
    blocks. Issues that make a motion wrong (collisions, limits, unstable wires, slot widths) never may be.

    Attributes:
        meaning: What the code means, as a phrase without a full stop.
        is_input_error: Whether the input is at fault (exit code 2) rather than the motion (exit code 3).
        acceptance: What a problem accepts that lists the code under ``accept``, or None if it may not.
        remedy: Remedy for issues that state none of their own.
        message: Template of the message with named fields, as for :meth:`str.format`. None if the words
            depend on figures, or if several places of the code have sentences of their own.
    """

    meaning: str
    is_input_error: bool = False
    acceptance: str | None = None
    remedy: str | None = None
    message: str | None = None
