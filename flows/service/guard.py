"""The guard before Prefect's server: which requests it lets through.

Prefect checks the key below /api. But it takes a body without Content-Type as JSON,
reads a body before it checks the key, answers any Host and any Origin, and fails on a
first WebSocket message that is no JSON object. `Guard` refuses these. Starlette's
TrustedHostMiddleware checks no port, no second Host header and no IPv6.
"""

import hmac
import ipaddress
import json
import socket
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from warehouse.bucket import is_loopback

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


def rules_for(host: str, port: int, key: str) -> AccessRules:
    """Return the rules of a server."""
    everywhere = host in _EVERYWHERE
    names = {f"[{host}]" if ":" in host else host} - set(_EVERYWHERE) - {"[::]"}
    if everywhere or is_loopback(host):
        names.update(_LOOPBACK)
    if everywhere:
        names.update({socket.gethostname(), socket.getfqdn()})
    ports = (f":{port}", "") if port == 80 else (f":{port}",)  # browsers leave it out
    hosts = {f"{name}{end}".lower() for name in names for end in ports}
    return AccessRules(frozenset(hosts), port, everywhere, key)


def refusal(scope: Scope, rules: AccessRules) -> tuple[int, str] | None:
    """Return status and reason if a request or a new WebSocket is refused."""
    headers = Headers(scope=scope)
    hosts, origins = headers.getlist("host"), headers.getlist("origin")
    if len(hosts) != 1 or not rules.names_server(hosts[0]):
        names = ", ".join(sorted(rules.hosts))
        return 421, f"Expected one Host of {names}, got {hosts}."
    # Only pages of the same name and port; programs send no Origin.
    page = f"http://{hosts[0].lower()}"
    if any(origin.lower() != page for origin in origins):
        return 403, f"Only pages of {page} may ask, got Origin {origins}."
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
        why = refusal(scope, self.rules) if kind in ("http", "websocket") else None
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
