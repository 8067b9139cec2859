"""The 3D view of pages: WebGL scripts that the service sends as modules and offline files hold as text."""

import functools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

FOLDER: Final = Path(__file__).resolve().parent
"""Where the modules lie."""
MODULES: Final = ("matrix.js", "orbit.js", "panels.js")
"""Modules of plain WebGL in the order in which they need one another."""
THREE_MODULES: Final = ("matrix.js", "orbit.js", "stage.js")
"""Modules that draw by three.js, the same."""
FILM_MODULES: Final = (*THREE_MODULES, "film.js")
"""Modules that draw a plan, the same."""


def script(own: str, modules: Sequence[str] = MODULES) -> str:
    """A script that imports from these modules, as one text that imports nothing; three.js not included."""
    texts = [*((FOLDER / name).read_text("utf-8") for name in modules), own]
    whole = "\n".join(
        re.sub(r'^import .* from "\./[\w./]+";\n', "", text, flags=re.MULTILINE) for text in texts
    )
    return "(() => {\n" + re.sub(r"^export ", "", whole, flags=re.MULTILINE) + "})();\n"


@functools.cache
def three() -> str:
    """three.js as a script that imports nothing and leaves all that it has in ``THREE``."""
    core, module = (
        (FOLDER / "vendor" / f"three.{name}.min.js").read_text("utf-8") for name in ("core", "module")
    )
    core = re.sub(r"export\s*\{([^{}]*)\};?\s*$", lambda found: f"return {{{_fields(found[1])}}};", core)
    module = re.sub(r'export\s*\{[^{}]*\}\s*from\s*"\./three\.core\.min\.js";?', "", module)
    module = re.sub(
        r'import\s*\{([^{}]*)\}\s*from\s*"\./three\.core\.min\.js";?',
        lambda found: f"const {{{_fields(found[1], swapped=True)}}} = core;",
        module,
    )
    module = re.sub(
        r"export\s*\{([^{}]*)\};?\s*$", lambda found: f"return {{...core, {_fields(found[1])}}};", module
    )
    return f"const THREE = (() => {{\nconst core = (() => {{\n{core}\n}})();\n{module}\n}})();\n"


def _fields(names: str, swapped: bool = False) -> str:
    """Names of an export, "own as told, ...", as an object's fields, or of an import as a pattern."""
    out = []
    for name in filter(None, (one.strip() for one in names.split(","))):
        own, _, told = name.partition(" as ")
        own, told = own.strip(), (told or own).strip()
        out.append(f"{own}:{told}" if swapped else f"{told}:{own}")
    return ",".join(out)
