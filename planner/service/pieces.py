"""Type of long readings that share the readers of the service."""

from collections.abc import Generator
from typing import TypeVar

Read = TypeVar("Read")
Pieces = Generator[None, None, Read]
"""A reading in pieces: a generator that waits for its turn at each ``yield`` and returns its result."""
