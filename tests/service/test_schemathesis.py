"""The API against its own OpenAPI document, by schemathesis: no status 500, and answers as documented."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import schemathesis
import yaml
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from planner import Client, load
from tests import small_problem
from tests.element.shells import cap, shell
from tests.service.support import Process

CHECKS = [not_a_server_error, status_code_conformance, content_type_conformance, response_schema_conformance]


@pytest.fixture(scope="module")
def server_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Process]:
    data = tmp_path_factory.mktemp("fuzz") / "data"
    process = Process(data, module="tests.service.fake_team", arguments=(str(data), "")).wait()
    yield process
    process.stop()
    assert "Traceback" not in process.log.read_text()


def ask(operation: Any, known: dict[str, Any], examples: int) -> None:
    """Send allowed and forbidden requests of the document; half of them address existing objects."""

    @seed(31)
    @settings(max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(operation.as_strategy(), st.booleans())
    def check_case(case: schemathesis.Case, is_known: bool) -> None:
        if is_known:
            case.path_parameters |= {
                name: item for name, item in known.items() if name in case.path_parameters
            }
        case.validate_response(case.call(timeout=60), checks=CHECKS)

    check_case()


def fuzz(served: Process, folder: Path, examples: int) -> None:
    schema = schemathesis.openapi.from_url(f"{served.url}/openapi.json")
    client, problem = Client(served.url), load(small_problem.write(folder))
    operations = [found.ok() for found in schema.get_all_operations()]
    assert len(operations) >= 18
    element = shell(folder, cap(n=5), {"count": 6, "off_surface_mm": 60})
    template = yaml.safe_load((folder / "held.yaml").read_text())
    cell = Path(template["cell"])
    files = {"shell.obj": (folder / "shell.obj").read_bytes(), cell.name: cell.read_bytes()}
    files["held.yaml"] = yaml.safe_dump({**template, "cell": cell.name}).encode()
    for operation in operations:
        known: dict[str, Any] = {}
        if "{job}" in operation.path:
            known["job"] = client.submit(problem)
        if "{draft}" in operation.path:
            known |= {"draft": client.keep_draft(problem, "\u06a9\u0645\u0627\u0646")["id"], "number": 1}
        if "{element}" in operation.path:
            known["element"] = client.divide(element, files)
        ask(operation, known, examples)


def test_no_request_of_the_document_is_a_500(server_process: Process, tmp_path: Path) -> None:
    fuzz(server_process, tmp_path, 4)


@pytest.mark.long
def test_no_request_of_the_document_is_a_500_at_length(server_process: Process, tmp_path: Path) -> None:
    fuzz(server_process, tmp_path, 300)
