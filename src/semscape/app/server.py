"""The app as one ASGI application: routes, what goes wrong in words, and the guard before all of them."""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import FrameType

import uvicorn
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from semscape.app.desk import Desk
from semscape.app.pages import page_routes
from semscape.app.plain_words import plain_words
from semscape.app.routes import Parts, result_routes, run_routes
from semscape.app.security import Access, Guard
from semscape.app.uploads import TooLargeError
from semscape.app.workspace import BusyRunError, UnknownRunError
from semscape.errors import SemscapeError

_log = logging.getLogger(__name__)
_STATUS = {UnknownRunError: 404, BusyRunError: 409, TooLargeError: 413}


class AppServer(uvicorn.Server):
    """Serves the app; when it is asked to end, it does not wait for what is being calculated."""

    def __init__(self, config: uvicorn.Config, desk: Desk) -> None:
        super().__init__(config)
        self._desk = desk

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Begin to end, on Ctrl-C or SIGTERM."""
        self._desk.close()
        super().handle_exit(sig, frame)


def build_app(parts: Parts, access: Access) -> FastAPI:
    """Return the application.

    Parameters
    ----------
    parts : Parts
        Workspace, queue and desk; the queue begins and ends with the application.
    access : Access
        The secrets of this start.
    """
    from semscape import __version__

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        with parts.desk, parts.queue:
            yield

    app = FastAPI(
        title="semscape app",
        version=__version__,
        description="What the page of `semscape app` asks its server for; for this machine alone.",
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
        lifespan=lifespan,
    )
    app.state.parts = parts
    app.include_router(run_routes(parts))
    app.include_router(result_routes(parts))
    app.include_router(page_routes(app))
    app.add_exception_handler(SemscapeError, _semscape_problem)
    app.add_exception_handler(RequestValidationError, _wrong_request)
    app.add_exception_handler(HTTPException, _http_problem)
    app.add_exception_handler(Exception, _fault)
    app.add_middleware(Guard, access=access, unlimited=("/files",))
    return app


async def _semscape_problem(_: Request, error: Exception) -> JSONResponse:
    status = next((code for kind, code in _STATUS.items() if isinstance(error, kind)), 400)
    return JSONResponse({"detail": plain_words(str(error))}, status_code=status)


async def _wrong_request(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    told = [f"{'.'.join(str(part) for part in item['loc'][1:])}: {item['msg']}" for item in error.errors()]
    return JSONResponse({"detail": "; ".join(told)}, status_code=422)


async def _http_problem(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    return JSONResponse({"detail": str(error.detail)}, status_code=error.status_code, headers=error.headers)


async def _fault(request: Request, error: Exception) -> JSONResponse:
    _log.error("%s %s failed", request.method, request.url.path, exc_info=error)
    text = f"semscape itself failed ({type(error).__name__}); what it was doing is in the window where it runs"
    return JSONResponse({"detail": text}, status_code=500)
