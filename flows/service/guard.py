"""What may be asked of the server of a store, and by whom: rules, and their guard.

Prefect takes a body without Content-Type as JSON, so that any page in a browser could
give it orders without being asked by the browser first; it answers to any Host, and it
opens WebSockets for any page. `Guard` applies these rules before Prefect sees anything.

Starlette's own check of hosts knows no port, no second Host header and no IPv6; and
Prefect's of the first message of a WebSocket fails on one that is no JSON object.
"""

import hmac
import ipaddress
import json
import socket
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from flows.report.page import hash_of, script
from flows.settings import is_loopback

_READING = ("GET", "HEAD", "OPTIONS")
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
_EVERYWHERE = ("0.0.0.0", "::")


# Bytes of a body or message of who has not shown the key: a ticket, or the key itself,
# has a hundred. Prefect's pages send more only with the key.
LARGEST = 1 << 16
_POLICY_VIOLATION = 1008  # close code of a WebSocket, RFC 6455 section 7.4.1
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
class Rules:
    """By which names a server is asked, and the key that its programs have."""

    hosts: frozenset[str]  # host headers that name it, lower case
    port: int
    everywhere: bool  # whether it listens on all addresses of this machine
    key: str = field(repr=False)  # what a program must know

    def is_ours(self, host: str) -> bool:
        """Return whether a Host header names this server.

        A stranger's name that was made to point here (DNS rebinding) does not. Of a
        server that listens everywhere any address in digits does: nobody can make
        that point elsewhere.
        """
        if host.lower() in self.hosts:
            return True
        name, _, port = host.rpartition(":")
        return self.everywhere and port == str(self.port) and _is_address(name)

    def has_key(self, headers: Mapping[str, str]) -> bool:
        """Return whether a request has the key, as Prefect's own clients send it."""
        expected = b"Basic " + b64encode(self.key.encode())
        return hmac.compare_digest(headers.get("authorization", "").encode(), expected)

    def is_key(self, text: str | bytes) -> bool:
        """Return whether a message on a WebSocket is the one that shows the key."""
        if len(text) > LARGEST:
            return False
        try:
            message = json.loads(text)
            given = message["token"] if message["type"] == "auth" else ""
            shown = given.encode()  # of half a character there are no bytes
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return False
        return hmac.compare_digest(shown, self.key.encode())


def rules_for(host: str, port: int, key: str) -> Rules:
    """Return the rules of a server."""
    everywhere = host in _EVERYWHERE
    names = set() if everywhere else {f"[{host}]" if ":" in host else host}
    if is_loopback(host):
        names.update(_LOOPBACK)
    if everywhere:
        names.update({*_LOOPBACK, socket.gethostname(), socket.getfqdn()})
    known = {f"{name}:{port}".lower() for name in names}
    if port == 80:  # the one that browsers leave out
        known |= {name.lower() for name in names}
    return Rules(frozenset(known), port, everywhere, key)


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a request is not let through."""

    status: int
    words: str


_TOO_LARGE = Refusal(413, f"Expected at most {LARGEST} bytes without the key.")


def refusal(scope: Scope, rules: Rules) -> Refusal | None:
    """Return why a request or an opening WebSocket is refused, None if it is not."""
    headers = Headers(scope=scope)
    hosts, origins = headers.getlist("host"), headers.getlist("origin")
    if len(hosts) != 1 or not rules.is_ours(hosts[0]):
        known = ", ".join(sorted(rules.hosts))
        return Refusal(421, f"Expected one Host of {known}, got {hosts}.")
    # Of pages only that of this very name and port; programs send no Origin.
    own = f"http://{hosts[0].lower()}"
    if any(origin.lower() != own for origin in origins):
        return Refusal(403, f"Only pages of {own} may ask, got Origin {origins}.")
    if scope["type"] == "websocket" or scope["method"] in _READING:
        return None
    if not origins and not rules.has_key(headers):
        words = "Expected the key of the store, as a program of it sends it."
        return Refusal(401, words)
    return _wrong_body(headers)


def _wrong_body(headers: Headers) -> Refusal | None:
    kinds = [k.split(";")[0].strip().lower() for k in headers.getlist("content-type")]
    sized = headers.get("content-length", "0") != "0" or "transfer-encoding" in headers
    if kinds == ["application/json"] or not (kinds or sized):
        return None
    return Refusal(415, f"Expected Content-Type: application/json, got {kinds}.")


def _is_address(name: str) -> bool:
    try:
        return not ipaddress.ip_address(name.strip("[]")).is_unspecified
    except ValueError:
        return False


@dataclass(frozen=True, slots=True)
class Guard:
    """An application that lets through only what the rules allow."""

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
        if not (why or self.rules.has_key(Headers(scope=scope))):
            body = await _small(receive)
            why = _TOO_LARGE if body is None else None
            receive = _again(body or [], receive)
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


async def _small(receive: Receive) -> list[Message] | None:
    """Return the messages of a whole body; None for one that is too large."""
    messages, size, more = [], 0, True
    while more:
        message = await receive()
        messages.append(message)
        size += len(message.get("body", b""))
        if size > LARGEST:
            return None
        more = message.get("more_body", False)
    return messages


def _again(messages: Sequence[Message], receive: Receive) -> Receive:
    """Give messages that were read once more, then what comes after them."""
    left = list(messages)

    async def given() -> Message:
        return left.pop(0) if left else await receive()

    return given


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
