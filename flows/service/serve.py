"""The server of one command, as a program: it serves until its input ends.

Its input ends with whoever holds it, however that one ends.
"""

import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from prefect.server.api.server import create_app
from prefect.settings import get_current_settings
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from flows.errors import RunError
from flows.report.night.site import Site
from flows.service.api import Api
from flows.service.database import patient
from flows.service.entry import Tickets, with_entry
from flows.service.pages.past import past_of
from flows.service.pages.policies import KNOWN, STORED
from flows.service.pages.routes import with_pages
from flows.service.rules import Rules, refusal, rules_for
from flows.service.state import Running
from flows.settings import store_folder

_POLICY_VIOLATION = 1008  # close code of a WebSocket, RFC 6455 section 7.4.1
# A page talks to its own server only. Prefect's pages set styles from scripts, and what
# draws their graphs compiles code of its own: allowed, since it too comes from here.
_PAGE = (
    "default-src 'self'; connect-src 'self' ws://{host}; "
    "script-src 'self' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
_NOTHING = "default-src 'none'; frame-ancestors 'none'"
_POLICY, _OPENER = "Content-Security-Policy", "Cross-Origin-Opener-Policy"
_ALWAYS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    _OPENER: "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


@dataclass(frozen=True, slots=True)
class Guard:
    """An application that lets through only what the rules allow.

    Attributes:
        app: What is guarded.
        rules: Those of the server.
    """

    app: ASGIApp
    rules: Rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request or WebSocket, or the start of the server."""
        if scope["type"] == "http":
            await self._request(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._websocket(scope, receive, send)
        else:
            await self.app(scope, receive, send)

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        why = refusal(scope, self.rules)
        if why:
            answer = JSONResponse({"detail": why.words}, why.status)
            await answer(scope, receive, _with_headers(send, _NOTHING))
            return
        policy = _PAGE.format(host=Headers(scope=scope)["host"])
        await self.app(scope, receive, _with_headers(send, policy))

    async def _websocket(self, scope: Scope, receive: Receive, send: Send) -> None:
        if refusal(scope, self.rules):
            await receive()
            # Before it is accepted: the browser gets a 403.
            await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
        elif self.rules.has_key(Headers(scope=scope)):
            await self.app(scope, receive, send)
        else:
            await self.app(scope, _key_first(receive, send, self.rules), send)


def _key_first(receive: Receive, send: Send, rules: Rules) -> Receive:
    """Let no message through before the one with the key, as Prefect's clients send it.

    For the application who does not send it has hung up.
    """
    shown = False

    async def checked() -> Message:
        nonlocal shown
        message = await receive()
        if message["type"] != "websocket.receive" or shown:
            return message
        shown = rules.is_key(message.get("text") or message.get("bytes") or "")
        if shown:
            return message
        await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
        return {"type": "websocket.disconnect", "code": _POLICY_VIOLATION}

    return checked


def _with_headers(send: Send, policy: str) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            own = headers.get(_POLICY, "")
            always = _ALWAYS | {_POLICY: own if own in KNOWN else policy}
            if own == STORED:  # browsers show no sandbox that asks for this as well
                del always[_OPENER]
            for name, value in always.items():
                headers[name] = value
        await send(message)

    return sent


def app() -> ASGIApp:
    """Return the application of `modelgap up`; where it listens is in the settings."""
    api = get_current_settings().server.api
    return guarded(create_app(final=True), api.host, api.port, store_folder())


def guarded(
    prefect: ASGIApp, host: str, port: int, store: Path | None = None
) -> ASGIApp:
    """Return Prefect's application with the guard before it.

    Args:
        store: The store whose pages it serves as well; None for none.

    Raises:
        RunError: If Prefect was given no key: nothing is served without.
    """
    key = get_current_settings().server.api.auth_string
    if key is None or not key.get_secret_value():
        raise RunError("The server was given no key. Start it by modelgap up.")
    rules = rules_for(host, port, key.get_secret_value())
    app = with_entry(patient(prefect), rules, Tickets())
    if store is not None:
        to = Api(Running(host, port, "").url, rules.key)
        app = with_pages(app, rules, Site(store, "/", past_of(to)), Tickets())
    return Guard(app, rules)


_HOST = "127.0.0.1"


def serve(port: int) -> None:
    """Serve until standard input ends.

    Args:
        port: Where to listen, on this machine only.
    """
    app = guarded(create_app(ephemeral=True, final=True), _HOST, port)
    settings = uvicorn.Config(app, _HOST, port, log_level="error", proxy_headers=False)
    server = uvicorn.Server(settings)

    def end_with_input() -> None:
        sys.stdin.buffer.read()
        server.should_exit = True

    threading.Thread(target=end_with_input, daemon=True).start()
    server.run()


if __name__ == "__main__":
    serve(int(sys.argv[1]))
