"""The pages over a store that its server adds to Prefect's.

A browser asks for user and password once (HTTP Basic, RFC 7617) and keeps them for this
host and port; they are the two halves of the key of the store.
"""

from pathlib import Path, PurePosixPath
from threading import Lock

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route, Router
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from flows.report.index import INDEX, page_at
from flows.report.page import hash_of, script
from flows.service.guard import AccessRules

PAGES = "/pages"
# A page talks to its own server only. Prefect's pages set styles from scripts and
# compile code for their graphs.
_PAGE = (
    "default-src 'self'; connect-src 'self' ws://{host}; "
    "script-src 'self' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
# The index runs one script, ours. A stored page may come from another store and run
# scripts of its author for its curves: its sandbox is an origin of its own, without key
# or storage, that may request nothing.
_NO = "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
MADE = (
    f"default-src 'none'; script-src {hash_of(script('filter.js'))}; "
    f"style-src 'unsafe-inline'; img-src data:; {_NO}"
)
STORED = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; "
    f"style-src 'unsafe-inline'; img-src data: blob:; font-src data:; {_NO}"
)
_POLICY, _OPENER = "Content-Security-Policy", "Cross-Origin-Opener-Policy"
_ALWAYS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    _OPENER: "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_TEXT = "text/plain; charset=utf-8"
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".gif": "image/gif",
    ".png": "image/png",
}


def with_pages(app: ASGIApp, rules: AccessRules, store: Path) -> ASGIApp:
    """Return an application that also serves the index and the reports of a store."""
    lock = Lock()

    def read(address: str) -> bytes | None:
        with lock:
            return page_at(store, address)

    async def page(request: Request) -> Response:
        if not rules.has_key(request.headers):
            text = "The pages of the store need its key: modelgap up says where it is."
            challenge = {"WWW-Authenticate": 'Basic realm="modelgap", charset="UTF-8"'}
            return _response(text.encode(), MADE, 401, _TEXT, challenge)
        address = request.url.path.removeprefix(f"{PAGES}/")
        body = await run_in_threadpool(read, address)
        kind = _TYPES.get(PurePosixPath(address).suffix)
        if body is None or kind is None:
            text = f"This store has no such page. The list of pages: {PAGES}/{INDEX}"
            return _response(text.encode(), MADE, 404, _TEXT)
        stored = address != INDEX and kind == _TYPES[".html"]
        return _response(body, STORED if stored else MADE, 200, kind)

    async def first(_: Request) -> Response:
        return RedirectResponse(f"{PAGES}/{INDEX}", 307)

    routes = [
        Route(PAGES, first, methods=["GET"]),
        Route(f"{PAGES}/", first, methods=["GET"]),
        Route(f"{PAGES}/{{address:path}}", page, methods=["GET"]),
    ]
    router = Router(routes, redirect_slashes=False, default=app)

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        # Prefect's application handles the start and the end of the server.
        await (app if scope["type"] == "lifespan" else router)(scope, receive, send)

    return answer


def _response(
    body: bytes, policy: str, status: int, kind: str, headers: dict | None = None
) -> Response:
    headers = {_POLICY: policy, "Cache-Control": "no-store", **(headers or {})}
    return Response(body, status, headers, media_type=kind)


def with_policies(app: ASGIApp) -> ASGIApp:
    """Return an application whose pages may do no more than they have to."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                page = _PAGE.format(host=Headers(scope=scope)["host"])
                policy = headers.get(_POLICY)
                policy = policy if policy in (MADE, STORED) else page
                headers.update(_ALWAYS | {_POLICY: policy})
                if policy == STORED:  # browsers show no sandbox that asks for this too
                    del headers[_OPENER]
            await send(message)

        await app(scope, receive, send_with_headers)

    return answer
