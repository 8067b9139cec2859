"""Version of the package, in a module without imports so that every layer can state it."""

from typing import Final

__version__: Final = "0.1.0"
"""Version of the distribution; equal to ``version`` in ``pyproject.toml``."""
