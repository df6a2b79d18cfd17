"""Who may ask the app for anything: only the page that it opened itself, on this machine.

Every request must name this server as its host (a foreign name that leads here does not), come from a page of its own
where the browser tells, and bring the cookie that the address with the token was exchanged for. Pages may load nothing
from elsewhere.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "frame-src 'self'; worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
# A report is a file that may come from anywhere: it runs in an origin of its own and reaches nothing.
REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads allow-modals; default-src 'none'; script-src 'unsafe-inline' "
    "blob: data:; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; worker-src blob:; connect-src data: "
    "blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_SAFE_METHODS = {"GET", "HEAD"}
_MOST_BODY_BYTES = 1_000_000
_CLOSED = """<!doctype html><html lang="en"><meta charset="utf-8"><title>semscape</title>
<body><main><h1>This page is closed</h1><p>Open the address that <code>semscape app</code> printed when it started. It
holds a token that only you have; each start of the app makes a new one.</p></main></body></html>"""

# Who comes by a link from elsewhere brings no cookie, but does on the way from this page to itself.
_AGAIN = """<!doctype html><html lang="en"><meta charset="utf-8"><meta http-equiv="refresh" content="0; url=/">
<title>semscape</title><body><a href="/">semscape</a></body></html>"""


class Access:
    """The secrets of one start of the app.

    Parameters
    ----------
    port : int
        Where the server listens on 127.0.0.1.
    """

    def __init__(self, port: int) -> None:
        self.token = secrets.token_urlsafe(32)
        self._session = secrets.token_urlsafe(32)
        self._cookie = f"semscape-{port}"
        self.hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        self.address = f"http://{self.hosts[0]}/?token={self.token}"

    def knows(self, headers: Headers) -> bool:
        """Tell whether a request brings the session's cookie."""
        for line in headers.getlist("cookie"):
            try:
                held = SimpleCookie(line).get(self._cookie)
            except CookieError:
                continue
            if held is not None and _same(held.value, self._session):
                return True
        return False

    def exchanged(self, token: str) -> Response | None:
        """Return the redirection that gives the cookie for the token, None where it is not the right one."""
        if not _same(token, self.token):
            return None
        response = RedirectResponse("/", status_code=303)
        response.set_cookie(self._cookie, self._session, httponly=True, samesite="strict", path="/")
        return response


class Guard:
    """Middleware that lets only the app's own pages in, and says what they may load.

    Parameters
    ----------
    app : ASGI application
    access : Access
    unlimited : iterable of str
        Ends of paths whose bodies are limited elsewhere.
    """

    def __init__(self, app: ASGIApp, access: Access, unlimited: Iterable[str] = ()) -> None:
        self._app, self._access, self._unlimited = app, access, tuple(unlimited)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)

        async def guarded_send(message: Message) -> None:
            if message["type"] == "http.response.start":
                _add_headers(MutableHeaders(scope=message))
            await send(message)

        answer = self._refusal(scope, headers)
        if answer is not None:
            await answer(scope, receive, guarded_send)
            return
        if not scope["path"].endswith(self._unlimited):
            receive = _limited(receive, headers)
        await self._app(scope, receive, guarded_send)

    def _refusal(self, scope: Scope, headers: Headers) -> Response | None:
        """Return the answer to a request that may not go on."""
        access = self._access
        if headers.getlist("host") not in [[host] for host in access.hosts]:
            return _problem(403, "the request was meant for another host than this one")
        origins = [f"http://{host}" for host in access.hosts]
        origin = headers.get("origin")
        if origin is not None and origin not in origins:
            return _problem(403, "the request comes from another page than semscape's own")
        if scope["method"] not in _SAFE_METHODS and origin is None:
            return _problem(403, "a request that changes something must tell its origin")
        # An ordinary link from elsewhere may open the page; it brings no cookie, for that is of SameSite=Strict.
        is_foreign = headers.get("sec-fetch-site", "none") not in ("same-origin", "none")
        is_link = headers.get("sec-fetch-mode") == "navigate" and scope["path"] == "/"
        if is_foreign and not is_link:
            return _problem(403, "the request comes from another page than semscape's own")
        if scope["path"] == "/" and scope["method"] == "GET":
            for part in scope["query_string"].decode("ascii", "replace").split("&"):
                name, _, value = part.partition("=")
                if name == "token" and (exchanged := access.exchanged(value)) is not None:
                    return exchanged
        if not access.knows(headers):
            if is_foreign:
                return HTMLResponse(_AGAIN)
            if scope["path"] == "/":
                return HTMLResponse(_CLOSED, status_code=401)
            return _problem(401, "open the address that semscape app printed when it started: it holds a new token")
        return None


def _problem(status: int, text: str) -> Response:
    return JSONResponse({"detail": text}, status_code=status)


def _same(given: str, expected: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "replace"), expected.encode())


def _add_headers(headers: MutableHeaders) -> None:
    headers.setdefault("Content-Security-Policy", PAGE_POLICY)
    headers.setdefault("Cache-Control", "no-store")
    headers["X-Content-Type-Options"] = "nosniff"
    headers["Referrer-Policy"] = "no-referrer"
    headers["Cross-Origin-Opener-Policy"] = "same-origin"
    headers["Cross-Origin-Resource-Policy"] = "same-origin"
    headers["X-Frame-Options"] = "DENY"


def _limited(receive: Receive, headers: Headers) -> Receive:
    """Return a `receive` that refuses a body that is larger than any form of the app."""
    taken = 0

    async def counted() -> Message:
        nonlocal taken
        message = await receive()
        taken += len(message.get("body", b""))
        if taken > _MOST_BODY_BYTES or _told_length(headers) > _MOST_BODY_BYTES:
            raise HTTPException(413, f"the request is larger than {_MOST_BODY_BYTES // 1_000_000} MB")
        return message

    return counted


def _told_length(headers: Headers) -> int:
    told = headers.get("content-length", "0")
    return int(told) if told.isdecimal() else 0
