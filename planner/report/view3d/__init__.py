"""3D view of pages: WebGL scripts that the service sends as modules and offline files embed as text."""

import functools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

FOLDER: Final = Path(__file__).resolve().parent
"""Folder of the modules."""
MODULES: Final = ("matrix.js", "orbit.js", "panels.js")
"""Modules of plain WebGL, in the order of their dependencies."""
THREE_MODULES: Final = ("matrix.js", "orbit.js", "stage.js")
"""Modules that draw with three.js, in the order of their dependencies."""
FILM_MODULES: Final = (*THREE_MODULES, "film.js")
"""Modules that draw a plan with three.js, in the order of their dependencies."""


def bundle_script(main_script: str, modules: Sequence[str] = MODULES) -> str:
    """Return a script and the modules that it imports as one script without imports and exports.

    three.js is not included: see :func:`three_js`.

    Args:
        main_script: Text of the script.
        modules: File names of the modules, in the order of their dependencies.
    """
    texts = [*((FOLDER / name).read_text("utf-8") for name in modules), main_script]
    joined = "\n".join(
        re.sub(r'^import .* from "\./[\w./]+";\n', "", text, flags=re.MULTILINE) for text in texts
    )
    return "(() => {\n" + re.sub(r"^export ", "", joined, flags=re.MULTILINE) + "})();\n"


@functools.cache
def three_js() -> str:
    """Return three.js as a script without imports that defines ``THREE``."""
    core, module = (
        (FOLDER / "vendor" / f"three.{name}.min.js").read_text("utf-8") for name in ("core", "module")
    )
    core = re.sub(
        r"export\s*\{([^{}]*)\};?\s*$", lambda match: f"return {{{_object_fields(match[1])}}};", core
    )
    module = re.sub(r'export\s*\{[^{}]*\}\s*from\s*"\./three\.core\.min\.js";?', "", module)
    module = re.sub(
        r'import\s*\{([^{}]*)\}\s*from\s*"\./three\.core\.min\.js";?',
        lambda match: f"const {{{_object_fields(match[1], swapped=True)}}} = core;",
        module,
    )
    module = re.sub(
        r"export\s*\{([^{}]*)\};?\s*$",
        lambda match: f"return {{...core, {_object_fields(match[1])}}};",
        module,
    )
    return f"const THREE = (() => {{\nconst core = (() => {{\n{core}\n}})();\n{module}\n}})();\n"


def _object_fields(names: str, swapped: bool = False) -> str:
    """Convert a list "a as b, c" of an export to fields "b:a,c:c" of an object.

    ``swapped`` is for a list of an import: the result "a:b,c:c" is a pattern that unpacks an object.
    """
    out = []
    for name in filter(None, (part.strip() for part in names.split(","))):
        before_as, _, after_as = name.partition(" as ")
        before_as, after_as = before_as.strip(), (after_as or before_as).strip()
        out.append(f"{before_as}:{after_as}" if swapped else f"{after_as}:{before_as}")
    return ",".join(out)
