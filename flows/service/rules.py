"""What may be asked of the server of a store, and by whom: pure rules, no server.

Prefect takes a body without Content-Type as JSON, so that any page in a browser could
give it orders without being asked by the browser first; it answers to any Host, and it
opens WebSockets for any page. `guard` applies these rules before Prefect sees anything.
"""

import hmac
import ipaddress
import json
import socket
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field

from starlette.datastructures import Headers
from starlette.types import Scope

from flows.settings import is_loopback

_READING = ("GET", "HEAD", "OPTIONS")
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
_EVERYWHERE = ("0.0.0.0", "::")


@dataclass(frozen=True, slots=True)
class Rules:
    """By which names a server is asked, and the key that its programs have.

    Attributes:
        hosts: Host headers that name it, lower case.
        port: Its port.
        everywhere: Whether it listens on all addresses of this machine.
        key: What a program must know.
    """

    hosts: frozenset[str]
    port: int
    everywhere: bool
    key: str = field(repr=False)

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
        try:
            told = json.loads(text)
            given = told["token"] if told["type"] == "auth" else ""
        except (ValueError, KeyError, TypeError, RecursionError):
            return False
        known = self.key.encode()
        return isinstance(given, str) and hmac.compare_digest(given.encode(), known)


def rules_for(host: str, port: int, key: str) -> Rules:
    """Return the rules of a server.

    Args:
        key: What a program must know.
    """
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
    """Why a request is not let through.

    Attributes:
        status: Of HTTP.
        words: What was expected, and what was got.
    """

    status: int
    words: str


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
