"""The pages over a store, for who has its key.

A browser that follows a link sends no key, and a cookie would be seen by every server
of this machine. So what it gets first is a page with nothing in it, whose script takes
the key from where Prefect's pages keep it, asks for a ticket, and goes to the same
address with that: the page, once. A program sends its key and gets the page at once.
"""

from collections.abc import Mapping

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from flows.report.night.site import Answer, Site
from flows.service.entry import Tickets
from flows.service.pages.policies import DOOR, MADE, STORED
from flows.service.rules import Rules

PAGES = "/pages"
_DOOR = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>modelgap</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<p id="said">Opening the pages of the store needs JavaScript.</p>
<script src="/pages.js"></script></html>
"""
_SCRIPT = """const said = document.getElementById("said");
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


def with_pages(app: ASGIApp, rules: Rules, site: Site, tickets: Tickets) -> ASGIApp:
    """Return an application that also serves the pages over a store.

    Args:
        app: What everything else goes to; guarded, as the whole must be.
        tickets: Those given for pages; none of them opens anything else.
    """

    async def page(request: Request) -> Response:
        shown = request.query_params.get("ticket")
        if not rules.has_key(request.headers) and not tickets.take(shown):
            return _html(_DOOR.encode(), DOOR)
        address = request.url.path.removeprefix(f"{PAGES}/")
        found = await run_in_threadpool(site.answer, address)
        return _answered(found)

    async def first(_: Request) -> Response:
        return RedirectResponse(f"{PAGES}/index.html", 307)

    async def script(_: Request) -> Response:
        return Response(_SCRIPT, media_type="text/javascript")

    async def give(request: Request) -> Response:
        if not rules.has_key(request.headers):
            return JSONResponse({"detail": "Expected the key of the store."}, 401)
        kept = {"Cache-Control": "no-store"}
        return JSONResponse({"ticket": tickets.give()}, headers=kept)

    own = Starlette(
        routes=[
            Route(f"{PAGES}.js", script, methods=["GET"]),
            Route(f"{PAGES}/ticket", give, methods=["POST"]),
            Route(PAGES, first, methods=["GET"]),
            Route(f"{PAGES}/", first, methods=["GET"]),
            Route(f"{PAGES}/{{address:path}}", page, methods=["GET"]),
        ]
    )

    async def chosen(scope: Scope, receive: Receive, send: Send) -> None:
        await (own if _is_ours(scope) else app)(scope, receive, send)

    return chosen


def _is_ours(scope: Mapping) -> bool:
    path = scope.get("path", "")
    ours = path in (PAGES, f"{PAGES}.js") or path.startswith(f"{PAGES}/")
    return scope["type"] == "http" and ours


def _answered(found: Answer | None) -> Response:
    if found is None:
        return _html(_NOTHING.encode(), MADE, 404, "text/plain; charset=utf-8")
    policy = STORED if found.stored and found.type.startswith("text/html") else MADE
    return _html(found.body, policy, 200, found.type)


def _html(
    body: bytes, policy: str, status: int = 200, kind: str = "text/html; charset=utf-8"
) -> Response:
    headers = {"Content-Security-Policy": policy, "Cache-Control": "no-store"}
    return Response(body, status, headers, media_type=kind)
