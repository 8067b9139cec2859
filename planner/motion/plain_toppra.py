"""The parts of the package ``toppra`` that time paths, without the pictures that it could draw.

It loads ``matplotlib.pyplot``, which nothing here asks for and which takes as long to load as all of Drake.
Until it is used, something else stands in its place.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

__all__ = [
    "TOPPRA",
    "AbstractGeometricPath",
    "DiscretizationType",
    "JointAccelerationConstraint",
    "LinearConstraint",
]


class _Later(ModuleType):
    """Loads the module of its name when something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # what the import itself looks for
            raise AttributeError(name)
        return getattr(importlib.import_module(self.__name__), name)


@contextmanager
def _stand_in(package: str, module: str) -> Iterator[None]:
    stands = {f"{package}.{module}": _Later(f"{package}.{module}"), package: _Later(package)}
    lacking = [name for name in stands if name not in sys.modules]
    setattr(stands[package], module, stands[f"{package}.{module}"])
    sys.modules.update({name: stands[name] for name in lacking})
    try:
        yield
    finally:
        for name in lacking:
            del sys.modules[name]


with _stand_in("matplotlib", "pyplot"):
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, LinearConstraint
    from toppra.interpolator import AbstractGeometricPath
