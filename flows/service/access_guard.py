"""The guard before Prefect's server, and the pages of the store behind it.

Prefect checks the key below /api. But it takes a body without Content-Type as JSON,
reads a body before it checks the key, answers any Host and any Origin, and fails on a
first WebSocket message that is no JSON object. `Guard` refuses these. Starlette's
TrustedHostMiddleware checks no port, no second Host header and no IPv6.

For a page a browser asks for user and password once (HTTP Basic, RFC 7617) and keeps
them for this host and port; they are the two halves of the key of the store.
"""

import hmac
import ipaddress
import json
import socket
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from threading import Lock

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route, Router
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from flows.report.page import hash_script, read_page_script
from flows.report.store_index import INDEX, read_page
from flows.settings import resolve_store_folder
from residual.errors import RunError
from warehouse.bucket import is_loopback_host

_READING = ("GET", "HEAD", "OPTIONS")
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
_EVERYWHERE = ("0.0.0.0", "::")
LARGEST = 1 << 16  # bytes of the message with the key
# Policy of a refusal.
_ALONE = {"Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'"}
_POLICY_VIOLATION = 1008  # close code of a WebSocket, RFC 6455 section 7.4.1


@dataclass(frozen=True, slots=True)
class AccessRules:
    """The names of a server, and its key."""

    hosts: frozenset[str]  # valid Host headers, lower case
    port: int
    everywhere: bool  # listens on all addresses of this machine
    key: str = field(repr=False)

    def names_server(self, host: str) -> bool:
        """Return whether a Host header names this server.

        Other names that resolve to it (DNS rebinding) do not. If the server listens on
        all addresses, every numeric address does, since it cannot be rebound.
        """
        name, _, port = host.rpartition(":")
        anyhow = self.everywhere and port == str(self.port) and _is_address(name)
        return anyhow or host.lower() in self.hosts

    def has_key(self, headers: Mapping[str, str]) -> bool:
        """Return whether a request has the key in HTTP Basic."""
        expected = b"Basic " + b64encode(self.key.encode())
        return hmac.compare_digest(headers.get("authorization", "").encode(), expected)

    def is_key(self, text: str | bytes) -> bool:
        """Return whether a WebSocket message is the authentication with the key."""
        try:
            message = json.loads(text) if len(text) <= LARGEST else {}
            token = message["token"] if message["type"] == "auth" else ""
            shown = token.encode()  # of half a character there are no bytes
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return False
        return hmac.compare_digest(shown, self.key.encode())


def build_access_rules(host: str, port: int, key: str) -> AccessRules:
    """Return the rules of a server."""
    everywhere = host in _EVERYWHERE
    names = {f"[{host}]" if ":" in host else host} - set(_EVERYWHERE) - {"[::]"}
    if everywhere or is_loopback_host(host):
        names.update(_LOOPBACK)
    if everywhere:
        names.update({socket.gethostname(), socket.getfqdn()})
    ports = (f":{port}", "") if port == 80 else (f":{port}",)  # browsers leave it out
    hosts = {f"{name}{end}".lower() for name in names for end in ports}
    return AccessRules(frozenset(hosts), port, everywhere, key)


def check_access(scope: Scope, rules: AccessRules) -> tuple[int, str] | None:
    """Return status and reason if a request or a new WebSocket is refused."""
    headers = Headers(scope=scope)
    hosts, origins = headers.getlist("host"), headers.getlist("origin")
    if len(hosts) != 1 or not rules.names_server(hosts[0]):
        names = ", ".join(sorted(rules.hosts))
        return 421, f"Expected one Host of {names}, got {hosts}."
    # Only pages of the same name and port; programs send no Origin.
    page = f"http://{hosts[0].lower()}"
    if any(origin.lower() != page for origin in origins):
        return 403, f"Only pages of {page} may send requests, got Origin {origins}."
    if scope["type"] == "websocket" or scope["method"] in _READING:
        return None
    if not rules.has_key(headers):
        return 401, "Expected the key of the store in HTTP Basic."
    kinds = [k.split(";")[0].strip().lower() for k in headers.getlist("content-type")]
    sized = headers.get("content-length", "0") != "0" or "transfer-encoding" in headers
    if kinds == ["application/json"] or not (kinds or sized):
        return None
    return 415, f"Expected Content-Type: application/json, got {kinds}."


def _is_address(name: str) -> bool:
    try:
        return not ipaddress.ip_address(name.strip("[]")).is_unspecified
    except ValueError:
        return False


@dataclass(frozen=True, slots=True)
class Guard:
    """An ASGI application that passes only allowed requests to another one."""

    app: ASGIApp
    rules: AccessRules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request, WebSocket or lifespan event."""
        kind = scope["type"]
        why = check_access(scope, self.rules) if kind in ("http", "websocket") else None
        if why and kind == "http":
            await JSONResponse({"detail": why[1]}, why[0], _ALONE)(scope, receive, send)
        elif why:
            await receive()  # closed before it is accepted: a 403
            await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
        else:
            if kind == "websocket" and not self.rules.has_key(Headers(scope=scope)):
                receive = _key_first(receive, send, self.rules)
            await self.app(scope, receive, send)


def _key_first(receive: Receive, send: Send, rules: AccessRules) -> Receive:
    """Pass no message before the one with the key; else disconnect."""
    shown = False

    async def checked() -> Message:
        nonlocal shown
        message = await receive()
        if message["type"] == "websocket.receive" and not shown:
            shown = rules.is_key(message.get("text") or message.get("bytes") or "")
            if not shown:
                await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
                message = {"type": "websocket.disconnect", "code": _POLICY_VIOLATION}
        return message

    return checked


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
    f"default-src 'none'; script-src {hash_script(read_page_script('filter.js'))}; "
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


def add_store_pages(app: ASGIApp, rules: AccessRules, store: Path) -> ASGIApp:
    """Return an application that also serves the index and the reports of a store."""
    lock = Lock()

    def read(address: str) -> bytes | None:
        with lock:
            return read_page(store, address)

    async def page(request: Request) -> Response:
        if not rules.has_key(request.headers):
            text = "The pages of the store need its key: modelgap up prints where it is."
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


def add_security_headers(app: ASGIApp) -> ASGIApp:
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


def app() -> ASGIApp:
    """Return Prefect's application with the pages of the store, behind the guard.

    Address and key are in Prefect's settings.
    """
    # Prefect's server, which takes its settings when it is imported.
    from prefect.server.api.server import create_app
    from prefect.settings import get_current_settings

    settings = get_current_settings().server.api
    host, port, key = settings.host, settings.port, settings.auth_string
    if key is None or not key.get_secret_value():
        raise RunError("The server has no key. Start it with modelgap up.")
    rules = build_access_rules(host, port, key.get_secret_value())
    served = add_store_pages(create_app(final=True), rules, resolve_store_folder())
    return Guard(add_security_headers(served), rules)
