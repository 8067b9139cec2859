"""Executors: submit a call of a generator function to this process or to another one.

Planning and proof accept an :class:`Executor` as ``executor``. They submit independent calls, continue, and
iterate over the items that these calls yield later. An executor changes how long a computation takes, but
never its result.

>>> items = executor.submit(clearances, model, q)  # starts at once if the executor is parallel
>>> other_work()
>>> list(items)  # waits for the items
"""

from collections.abc import Callable, Iterator
from typing import Any, Final, Protocol, TypeVar

Item = TypeVar("Item")


class Executor(Protocol):
    """Runs calls of generator functions, in this process or in parallel to it."""

    @property
    def parallel(self) -> bool:
        """Whether submitted calls run while the caller continues.

        If not, a call runs only when its items are requested, so submitting optional work early saves
        nothing.
        """

    def submit(self, work: Callable[..., Iterator[Item]], *arguments: Any) -> Iterator[Item]:
        """Submit a call of a generator function, with its arguments as they are now.

        Args:
            work: Generator function. It and its arguments must be picklable to run in another process.
            arguments: Positional arguments of ``work``.

        Returns:
            Iterator over the items that ``work`` yields. It raises what ``work`` raises.
        """


class SerialExecutor:
    """Runs each call in this process, when its items are requested."""

    parallel: Final = False

    def submit(self, work: Callable[..., Iterator[Item]], *arguments: Any) -> Iterator[Item]:
        """Return the generator of the call, which runs as the caller iterates over it."""
        return work(*arguments)


SERIAL: Final = SerialExecutor()
"""The default executor."""
