"""Every address with values that nobody thought of: no answer that the OpenAPI description does not know, no fault."""

from __future__ import annotations

from typing import Any

import schemathesis
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis.strategies import just
from schemathesis.checks import CHECKS, load_all_checks

from semscape.app.workspace import Workspace

EXAMPLES = 6
# What must hold for any request: no fault, only the statuses, kinds and shapes that are described.
load_all_checks()
ALWAYS = [
    CHECKS.get_one(name)
    for name in (
        "not_a_server_error",
        "status_code_conformance",
        "content_type_conformance",
        "response_schema_conformance",
    )
]
# Odd values for the names, and those of runs that are there, so that not all ends at "there is no such run".
quiet = settings(
    max_examples=EXAMPLES, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck)
)


def attempt(client: TestClient, names: dict[str, str], known: set[int], case: Any) -> None:
    if case.path_parameters:
        case.path_parameters.update(names)
    sent = case.as_transport_kwargs(base_url=str(client.base_url))
    sent["headers"] = {**dict(sent["headers"]), "Origin": client.headers["Origin"]}
    sent.pop("cookies", None)
    if isinstance(sent.get("data"), bytes):
        sent["content"] = sent.pop("data")
    answer = client.request(**sent)
    known.add(answer.status_code)
    case.validate_response(answer, checks=ALWAYS)


def test_the_api_answers_as_it_is_described(
    client: TestClient, uploaded: str, finished: str, workspace: Workspace
) -> None:
    before = {path.relative_to(workspace.folder.parent) for path in workspace.folder.parent.iterdir()}
    schema = schemathesis.openapi.from_dict(client.get("/api/openapi.json").json())
    statuses: dict[str, set[int]] = {}
    for found in schema.get_all_operations():
        operation = found.ok()
        if operation.path == "/api/events":
            continue  # it never ends
        known = statuses.setdefault(operation.label, set())
        for names in ({}, {"name": uploaded}, {"name": finished}):
            if names and (operation.method == "delete" or "{name}" not in operation.path):
                continue

            held = {"client": just(client), "names": just(names), "known": just(known)}
            quiet(given(**held, case=operation.as_strategy())(attempt))()
    assert len(statuses) >= 20
    assert sum(status < 300 for known in statuses.values() for status in known) >= 10
    assert {path.relative_to(workspace.folder.parent) for path in workspace.folder.parent.iterdir()} == before
    assert client.get("/api/runs").status_code == 200
