"""The app's page, its script, and the page about the API."""

from __future__ import annotations

import html
from importlib import resources
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.responses import HTMLResponse, JSONResponse, Response

from semscape.errors import BadInputError

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>semscape</title>
<link rel="icon" href="/static/icon.svg" type="image/svg+xml">
<script src="/static/app.js" defer></script>
</head>
<body><noscript>semscape's page needs JavaScript; it runs on this machine alone.</noscript></body>
</html>
"""
_API_STYLE = """:root { color-scheme: light dark; }
body {
  font: 1rem/1.5 system-ui, sans-serif; max-width: 80rem; margin: 0 auto; padding: 1rem; overflow-wrap: anywhere;
  background: light-dark(#ffffff, #14181d); color: light-dark(#1b2129, #e6eaef);
}
a { color: light-dark(#155fa8, #69aef5); }
table { border-collapse: collapse; }
th, td { text-align: left; vertical-align: top; padding: 0.3rem 0.6rem; border-bottom: 1px solid #8888; }
td:first-child { font-family: ui-monospace, monospace; }
"""
_ICON = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="6"
fill="#14506e"/><path d="M3 23c5 0 6-11 11-11s5 7 8 7 4-4 7-4v8z" fill="#fff"/></svg>"""


def read_bundle() -> bytes:
    """Return the script of the pages, which the package's build bundles.

    Raises
    ------
    BadInputError
        If it is not there.
    """
    try:
        return resources.files("semscape").joinpath("web", "app.js").read_bytes()
    except OSError as error:
        raise BadInputError(
            "the pages of the app are not in this installation; install semscape again, or run `make web` in a copy of "
            "its repository"
        ) from error


def page_routes(app: FastAPI) -> APIRouter:
    """Return the routes of what a browser shows; none of them is part of the API."""
    router = APIRouter(include_in_schema=False)

    @router.get("/")
    def page() -> Response:
        return HTMLResponse(PAGE)

    @router.get("/static/app.js")
    def script() -> Response:
        return Response(read_bundle(), media_type="text/javascript; charset=utf-8")

    @router.get("/static/icon.svg")
    @router.get("/favicon.ico")
    def icon() -> Response:
        return Response(_ICON, media_type="image/svg+xml")

    @router.get("/static/api.css")
    def style() -> Response:
        return Response(_API_STYLE, media_type="text/css; charset=utf-8")

    @router.get("/api/openapi.json")
    def schema() -> Response:
        return JSONResponse(app.openapi())

    @router.get("/api/docs")
    def docs() -> Response:
        return HTMLResponse(_api_page(app.openapi()))

    return router


def _api_page(schema: dict[str, Any]) -> str:
    """Return the OpenAPI description as a page of its own, without a script and without a request elsewhere."""
    rows = []
    for path, operations in schema["paths"].items():
        for method, operation in operations.items():
            given = [f"{item['name']} ({item['in']})" for item in operation.get("parameters", [])]
            if "requestBody" in operation:
                given.append(_kinds(operation["requestBody"]["content"]))
            answers = [
                f"{status}: {_kinds(answer.get('content', {})) or answer['description']}"
                for status, answer in operation["responses"].items()
            ]
            cells = (
                f"{method.upper()} {path}",
                operation.get("description", ""),
                ", ".join(given),
                "; ".join(answers),
            )
            rows.append("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>")
    models = []
    for name, model in schema["components"]["schemas"].items():
        fields = "".join(
            f"<li><code>{html.escape(key)}</code> {html.escape(_kind(value))} "
            f"{html.escape(value.get('description', ''))}"
            for key, value in model.get("properties", {}).items()
        )
        about = html.escape(model.get("description", ""))
        models.append(f'<h3 id="{html.escape(name)}">{html.escape(name)}</h3><p>{about}</p><ul>{fields}</ul>')
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="color-scheme" content="light dark">'
        '<title>semscape: API</title><link rel="stylesheet" href="/static/api.css"></head>'
        "<body><main><h1>API of semscape app</h1><p>For this machine alone, "
        'with the cookie of the page. The same as <a href="/api/openapi.json">OpenAPI</a>. '
        '<a href="/">Back to the runs</a></p>'
        "<table><thead><tr><th>Request<th>Meaning<th>Takes<th>Answers</thead><tbody>"
        + "".join(rows)
        + "</tbody></table><h2>Values</h2>"
        + "".join(models)
        + "</main></body></html>"
    )


def _kinds(content: dict[str, Any]) -> str:
    return ", ".join(_kind(held.get("schema", {})) if "json" in kind else kind for kind, held in content.items())


def _kind(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    if "anyOf" in schema:
        return " or ".join(_kind(item) for item in schema["anyOf"])
    if schema.get("type") == "array":
        return f"list of {_kind(schema.get('items', {}))}"
    return str(schema.get("type", "value"))
