"""The garbage collector skips permanent objects in the planner's own process, but none in a user's."""

from __future__ import annotations

import gc
import subprocess
import sys
import weakref

import pytest

from planner.runtime import memory


class _Cycle:
    """Refers to itself: only the collector frees it."""

    def __init__(self) -> None:
        self.reference = self


@pytest.mark.parametrize("fails", [False, True])
def test_the_collector_waits_and_then_goes_on(fails: bool) -> None:
    with pytest.raises(ZeroDivisionError) if fails else memory.gc_frozen(), memory.gc_frozen():
        assert not gc.isenabled()
        if fails:
            raise ZeroDivisionError
    assert gc.isenabled()


def test_a_collector_that_is_off_stays_off() -> None:
    gc.disable()
    try:
        with memory.gc_frozen():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_a_user_s_process_keeps_nothing_of_it() -> None:
    with memory.gc_frozen():
        ring = weakref.ref(_Cycle())
    gc.collect()
    assert ring() is None


def test_the_command_s_own_process_passes_modules_over() -> None:
    code = "import gc, sys; sys.argv[1:] = ['robots']\ntry:\n    from planner.__main__ import main; main()\n"
    code += "except SystemExit as end:\n    print(end.code, gc.isenabled(), gc.get_freeze_count())"
    command = [sys.executable, "-P", "-c", code]
    completed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[-3:]
    assert completed[:2] == ["0", "True"]
    assert int(completed[2]) > 10_000
