"""JSON schemas of problem files, from the very models that read them: one file's schema knows the operations
of all processes."""

from __future__ import annotations

import functools
from typing import Any, Final

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from planner import processes
from planner.issues import Issue
from planner.problem_file import ProblemFile
from planner.service.refusals import RefusedError
from planner.stock_file import SetupFile

IN_OPENAPI: Final = "#/components/schemas/{model}"


@functools.cache
def problem_schema(template: str = "#/$defs/{model}") -> tuple[dict[str, Any], dict[str, Any]]:
    """The schema of a problem file, and the definitions that it refers to by ``template``."""
    models: list[type[BaseModel]] = [ProblemFile, SetupFile, *processes.schemas().values()]
    found, together = models_json_schema([(m, "validation") for m in models], ref_template=template)
    definitions: dict[str, Any] = together["$defs"]
    choices: list[dict[str, Any]] = []
    for model in processes.schemas().values():
        definition = definitions[_name(found[model, "validation"])]
        definition["properties"]["setup"] = dict(found[SetupFile, "validation"])
        choices.append(dict(found[model, "validation"]))
    top = definitions[_name(found[ProblemFile, "validation"])]
    top["properties"]["operations"]["items"] = {"oneOf": choices}
    return dict(found[ProblemFile, "validation"]), definitions


def problem_file() -> dict[str, Any]:
    """The schema of a whole problem file, by itself."""
    reference, definitions = problem_schema()
    return {**reference, "$defs": definitions}


def process(name: str) -> dict[str, Any]:
    """The schema of one process's operation, by itself; raises :class:`RefusedError`, 404."""
    known = processes.schemas()
    if name not in known:
        have = ", ".join(known)
        raise RefusedError(
            404, Issue("service.not_found", f"process {name[:80]!r}: known are {have}", field="name")
        )
    _, definitions = problem_schema()
    return {"$ref": f"#/$defs/{known[name].__name__}", "$defs": definitions}


def _name(reference: Any) -> str:
    return str(reference["$ref"]).rsplit("/", 1)[1]
