"""The 3D view of pages: WebGL scripts that the service sends as modules and offline files hold as text."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

FOLDER: Final = Path(__file__).resolve().parent
"""Where the modules lie."""
MODULES: Final = ("matrix.js", "orbit.js", "panels.js")
"""Modules in the order in which they need one another."""


def script(own: str) -> str:
    """A script that imports from these modules, as one text that imports nothing."""
    texts = [*((FOLDER / name).read_text("utf-8") for name in MODULES), own]
    whole = "\n".join(
        re.sub(r'^import .* from "\./[\w.]+";\n', "", text, flags=re.MULTILINE) for text in texts
    )
    return "(() => {\n" + re.sub(r"^export ", "", whole, flags=re.MULTILINE) + "})();\n"
