"""What is wrong with a part file for its second reader."""

from __future__ import annotations


class UnreadError(ValueError):
    """A part file that the second reader cannot read; the message says why, without the file's name."""
