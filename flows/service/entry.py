"""How the page of a store gets the key: by an address that works once, and not long.

`modelgap up` asks for a ticket and prints an address that ends with it. A browser
keeps what follows the # to itself; the page there gives it back once, gets the key, and
puts it where Prefect's pages look for it. That belongs to one origin, port included: no
other page and no other server of this machine gets to see it, as they would a cookie.
"""

import json
import secrets
from collections.abc import Callable
from dataclasses import dataclass, field
from time import monotonic

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from flows.service.rules import Rules

OPEN = "/open"
LIFE = 600.0  # s that a ticket is good for
_MOST = 100  # tickets at a time; the oldest are dropped
_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>modelgap</title>
<p id="said">Opening the page of the store needs JavaScript.</p>
<script src="/open.js"></script></html>
"""
_SCRIPT = """const said = document.getElementById("said");
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


@dataclass(frozen=True, eq=False, slots=True)
class Tickets:
    """Tickets that were given and not yet used.

    Attributes:
        clock: Tells the time [s].
    """

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
    """Return an application with the page that opens all others before it.

    Args:
        app: What everything else goes to; guarded, as the whole must be.
    """

    def page(_: Request) -> Response:
        return HTMLResponse(_PAGE)

    def script(_: Request) -> Response:
        return Response(_SCRIPT, media_type="text/javascript")

    async def give(request: Request) -> Response:
        if not rules.has_key(request.headers):
            return JSONResponse({"detail": "Expected the key of the store."}, 401)
        return JSONResponse({"ticket": tickets.give()})

    async def take(request: Request) -> Response:
        if tickets.take(await _ticket(request)):
            return JSONResponse(
                {"key": rules.key}, headers={"Cache-Control": "no-store"}
            )
        told = "This address has been used, or is too old. Another: modelgap up."
        return JSONResponse({"detail": told}, 403)

    own = [
        Route(OPEN, page, methods=["GET"]),
        Route(OPEN, take, methods=["POST"]),
        Route(f"{OPEN}.js", script, methods=["GET"]),
        Route(f"{OPEN}/ticket", give, methods=["POST"]),
    ]
    paths, opening = {route.path for route in own}, Starlette(routes=own)

    async def chosen(scope: Scope, receive: Receive, send: Send) -> None:
        ours = scope["type"] == "http" and scope["path"] in paths
        await (opening if ours else app)(scope, receive, send)

    return chosen


async def _ticket(request: Request) -> object:
    try:
        told = json.loads(await request.body())
    except (ValueError, RecursionError):
        return None
    return told.get("ticket") if isinstance(told, dict) else None
