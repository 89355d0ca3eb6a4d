"""Requests that no server of a store may let through, played to its guard."""

import asyncio
from base64 import b64encode
from collections.abc import Iterator

from flows.service.guard import Guard, rules_for

KEY = "modelgap:a-key-of-thirty-two-letters-or-more"
_RULES = rules_for("127.0.0.1", 4200, KEY)
_HOST, _OWN = "127.0.0.1:4200", "http://127.0.0.1:4200"
_HOSTS = (
    "evil.example:4200",
    "127.0.0.1.evil.example:4200",
    "127.0.0.1",
    "127.0.0.1:4201",
    "127.0.0.1:4200 evil.example",
    "evil@127.0.0.1:4200",
    "0.0.0.0:4200",
    "2130706433:4200",
    "[::ffff:127.0.0.1]:4200",
    "",
)
_ORIGINS = (
    "http://evil.example",
    "http://evil.example:4200",
    "https://127.0.0.1:4200",
    "http://127.0.0.1",
    "http://127.0.0.1:42000",
    "http://127.0.0.1:4200.evil.example",
    "http://localhost:4200",
    "null",
    "file://",
    "",
    "http://127.0.0.1:4200, http://evil.example",
)
_KINDS = (
    None,
    "text/plain",
    "application/x-www-form-urlencoded",
    "multipart/form-data",
)
_KEYS = (None, "", "modelgap:", "modelgap:wrong", KEY[:-1], KEY + "x", KEY.upper())


def requests() -> Iterator[tuple[str, dict, bool]]:
    """Give name, request as ASGI has it, and whether it is to be let through."""
    own, json = ("origin", _OWN), ("content-type", "application/json")
    body, key = ("content-length", "12"), _signed(KEY)
    yield "own page", _scope("POST", own, json, body), True
    yield "own program", _scope("POST", key, json, body), True
    yield "own reading", _scope("GET"), True
    for host in _HOSTS:
        yield f"Host {host!r}", _scope("GET", host=host), False
        yield f"Host {host!r}, key", _scope("POST", key, json, body, host=host), False
        yield (
            f"Host {host!r}, events",
            _scope("GET", host=host, kind="websocket"),
            False,
        )
    for origin in _ORIGINS:
        given = ("origin", origin)
        for method in ("GET", "POST", "DELETE", "OPTIONS"):
            told = f"{method} from {origin!r}"
            yield told, _scope(method, given, json, body, key), False
        yield f"events for {origin!r}", _scope("GET", given, kind="websocket"), False
        two = _scope("POST", own, given, json, body)
        yield f"two pages, {origin!r}", two, False
    for kind in _KINDS:
        given = () if kind is None else (("content-type", kind),)
        yield f"body of {kind}", _scope("POST", own, *given, body), False
        yield f"body of {kind}, key", _scope("POST", key, *given, body), False
        twice = _scope("PUT", own, json, *(given or (json,)), body)
        yield f"JSON and {kind}", twice, False
    for word in _KEYS:
        given = () if word is None else (_signed(word),)
        for method in ("POST", "PUT", "PATCH", "DELETE"):
            told = f"{method} with key {word!r}"
            yield told, _scope(method, *given, json, body), False


def let_through(asked: dict) -> bool:
    """Return whether a request reaches what is behind the guard."""
    reached = False

    async def behind(scope, receive, send) -> None:
        nonlocal reached
        reached = True

    async def receive() -> dict:
        return {"type": "websocket.connect"}

    async def send(message: dict) -> None:
        pass

    asyncio.run(Guard(behind, _RULES)(asked, receive, send))
    return reached


def _signed(key: str) -> tuple[str, str]:
    return "authorization", f"Basic {b64encode(key.encode()).decode()}"


def _scope(method: str, *given, host: str = _HOST, kind: str = "http") -> dict:
    headers = [("host", host), *given]
    return {
        "type": kind,
        "method": method,
        "path": "/api/flows/",
        "query_string": b"",
        "headers": [(k.encode(), v.encode()) for k, v in headers],
    }
