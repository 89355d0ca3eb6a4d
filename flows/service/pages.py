"""The pages that a store's server adds to Prefect's, and how a browser gets in.

`modelgap up` asks for a ticket and prints an address that ends with it. A browser
keeps what follows the # to itself; the page there gives it back once, gets the key, and
puts it where Prefect's pages look for it. That belongs to one origin, port included: no
other page and no other server of this machine gets to see it, as they would a cookie.

A browser that follows a link to a page over the store sends no key. So what it gets
first is a page with nothing in it, whose script takes the key from that place, asks for
a ticket, and goes to the same address with it: the page, once. A program sends its key
and gets the page at once.
"""

import json
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from threading import Lock
from time import monotonic

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import (
    HTMLResponse,
    JSONResponse,
    RedirectResponse,
    Response,
)
from starlette.routing import Route, Router
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from flows.report.index import INDEX, page_at
from flows.report.page import hash_of, script
from flows.service.guard import LARGEST, OPEN, Rules

PAGES = "/pages"
# A page talks to its own server only. Prefect's pages set styles from scripts, and what
# draws their graphs compiles code of its own: allowed, since it too comes from here.
_PAGE = (
    "default-src 'self'; connect-src 'self' ws://{host}; "
    "script-src 'self' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
# The index of the store is made now and runs one script, ours. A page that is stored
# may be of another store and another author, copied into this one, and may have
# scripts, for its curves: it gets an origin of its own, without key or storage, that
# may ask nothing.
_NO = "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
MADE = (
    f"default-src 'none'; script-src {hash_of(script('filter.js'))}; "
    f"style-src 'unsafe-inline'; img-src data:; {_NO}"
)
STORED = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; "
    f"style-src 'unsafe-inline'; img-src data: blob:; font-src data:; {_NO}"
)
# Without a key: a page with nothing in it, whose script asks for a ticket.
DOOR = (
    "default-src 'none'; script-src 'self'; connect-src 'self'; "
    f"img-src data:; style-src 'unsafe-inline'; {_NO}"
)
KNOWN = frozenset({MADE, STORED, DOOR})
_POLICY, _OPENER = "Content-Security-Policy", "Cross-Origin-Opener-Policy"
_ALWAYS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    _OPENER: "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
LIFE = 600.0  # s that a ticket is good for
_MOST = 100  # tickets at a time; the oldest are dropped
_FRESH = {"Cache-Control": "no-store"}
_ENTRY = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>modelgap</title>
<p id="said">Opening the page of the store needs JavaScript.</p>
<script src="/open.js"></script></html>
"""
_ENTRY_SCRIPT = """const said = document.getElementById("said");
const ticket = location.hash.slice(1);
history.replaceState(null, "", location.pathname);
said.textContent = "Opening ...";
fetch("/open", {
  method: "POST",
  headers: {"Content-Type": "application/json"},
  body: JSON.stringify({ticket}),
}).then(async (answer) => {
  if (!answer.ok) throw new Error((await answer.json()).detail);
  localStorage.setItem("prefect-password", btoa((await answer.json()).key));
  location.replace("/");
}).catch((error) => { said.textContent = error.message; });
"""
_DOOR = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>modelgap</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<p id="said">Opening the pages of the store needs JavaScript.</p>
<script src="/pages.js"></script></html>
"""
_DOOR_SCRIPT = """const said = document.getElementById("said");
const key = localStorage.getItem("prefect-password");
const none = "This browser does not have the key of the store. Open the address " +
  "that modelgap up prints, then this one again.";
if (key === null) {
  said.textContent = none;
} else {
  said.textContent = "Opening ...";
  fetch("/pages/ticket", {
    method: "POST",
    headers: {"Content-Type": "application/json", "Authorization": `Basic ${key}`},
    body: "{}",
  }).then(async (answer) => {
    if (!answer.ok) throw new Error(none);
    const ticket = (await answer.json()).ticket;
    location.replace(`${location.pathname}?ticket=${ticket}`);
  }).catch((error) => { said.textContent = error.message; });
}
"""
_NOTHING = "There is no such page of this store. All that there are: /pages/index.html"
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".gif": "image/gif",
    ".png": "image/png",
}


@dataclass(frozen=True, eq=False, slots=True)
class Tickets:
    """Tickets that were given and not yet used."""

    clock: Callable[[], float] = monotonic
    _ends: dict[str, float] = field(default_factory=dict, repr=False)

    def give(self) -> str:
        """Return a new one."""
        while len(self._ends) >= _MOST:
            del self._ends[next(iter(self._ends))]
        ticket = secrets.token_urlsafe(32)
        self._ends[ticket] = self.clock() + LIFE
        return ticket

    def take(self, ticket: object) -> bool:
        """Return whether a ticket is good; from now on it is not."""
        ends = self._ends.pop(ticket, None) if isinstance(ticket, str) else None
        return ends is not None and self.clock() < ends


def with_entry(app: ASGIApp, rules: Rules, tickets: Tickets) -> ASGIApp:
    """Return an application with the page that opens all others before it."""

    async def page(_: Request) -> Response:
        return HTMLResponse(_ENTRY)

    async def take(request: Request) -> Response:
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > LARGEST:
                told = f"Expected at most {LARGEST} bytes without the key."
                return JSONResponse({"detail": told}, 413)
        if tickets.take(_ticket_in(body)):
            return JSONResponse({"key": rules.key}, headers=_FRESH)
        told = "This address has been used, or is too old. Another: modelgap up."
        return JSONResponse({"detail": told}, 403)

    routes = [
        Route(OPEN, page, methods=["GET"]),
        Route(OPEN, take, methods=["POST"]),
        *_shared(OPEN, _ENTRY_SCRIPT, rules, tickets),
    ]
    return _before(app, routes)


def with_pages(app: ASGIApp, rules: Rules, store: Path, tickets: Tickets) -> ASGIApp:
    """Return an application that also serves the index and reports of a store.

    Args:
        tickets: Those given for pages; none of them opens anything else.
    """
    one_at_a_time = Lock()

    async def page(request: Request) -> Response:
        shown = request.query_params.get("ticket")
        if not rules.has_key(request.headers) and not tickets.take(shown):
            return _html(_DOOR.encode(), DOOR)
        address = request.url.path.removeprefix(f"{PAGES}/")
        return _answered(address, await run_in_threadpool(read, address))

    def read(address: str) -> bytes | None:
        with one_at_a_time:
            return page_at(store, address)

    async def first(_: Request) -> Response:
        return RedirectResponse(f"{PAGES}/{INDEX}", 307)

    routes = [
        *_shared(PAGES, _DOOR_SCRIPT, rules, tickets),
        Route(PAGES, first, methods=["GET"]),
        Route(f"{PAGES}/", first, methods=["GET"]),
        Route(f"{PAGES}/{{address:path}}", page, methods=["GET"]),
    ]
    return _before(app, routes)


def with_policies(app: ASGIApp) -> ASGIApp:
    """Return an application whose pages may do no more than they have to."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                page = _PAGE.format(host=Headers(scope=scope)["host"])
                policy = headers.get(_POLICY, "")
                headers.update(_ALWAYS | {_POLICY: policy if policy in KNOWN else page})
                if policy == STORED:  # browsers show no sandbox that asks for this too
                    del headers[_OPENER]
            await send(message)

        await app(scope, receive, sent)

    return answer


def _shared(place: str, code: str, rules: Rules, tickets: Tickets) -> list[Route]:
    """Return what both ways in have: a script, and tickets for who has the key."""

    async def script(_: Request) -> Response:
        return Response(code, media_type="text/javascript")

    async def give(request: Request) -> Response:
        if not rules.has_key(request.headers):
            return JSONResponse({"detail": "Expected the key of the store."}, 401)
        return JSONResponse({"ticket": tickets.give()}, headers=_FRESH)

    return [
        Route(f"{place}.js", script, methods=["GET"]),
        Route(f"{place}/ticket", give, methods=["POST"]),
    ]


def _before(app: ASGIApp, routes: Sequence[Route]) -> ASGIApp:
    own = Router(routes, redirect_slashes=False, default=app)

    async def chosen(scope: Scope, receive: Receive, send: Send) -> None:
        # What the other one starts and ends with is its own matter.
        await (app if scope["type"] == "lifespan" else own)(scope, receive, send)

    return chosen


def _ticket_in(body: bytes) -> object:
    try:
        return json.loads(body)["ticket"]
    except (ValueError, RecursionError, KeyError, TypeError):
        return None


def _answered(address: str, body: bytes | None) -> Response:
    kind = _TYPES.get(PurePosixPath(address).suffix)
    if body is None or kind is None:
        return _html(_NOTHING.encode(), MADE, 404, "text/plain; charset=utf-8")
    stored = address != INDEX and kind == _TYPES[".html"]
    return _html(body, STORED if stored else MADE, 200, kind)


def _html(
    body: bytes, policy: str, status: int = 200, kind: str = "text/html; charset=utf-8"
) -> Response:
    headers = {"Content-Security-Policy": policy, **_FRESH}
    return Response(body, status, headers, media_type=kind)
