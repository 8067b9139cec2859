"""Type of long readings that share the reader processes of the service."""

from collections.abc import Generator
from typing import TypeVar

ReadResult = TypeVar("ReadResult")
Pieces = Generator[None, None, ReadResult]
"""A reading in parts: a generator that waits for its turn at each ``yield`` and returns its result."""
