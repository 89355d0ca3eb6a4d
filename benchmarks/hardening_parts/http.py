"""Requests that no server of a store may let through, and files with one bad value."""

import asyncio
import re
from base64 import b64encode
from collections.abc import Iterator

import numpy as np

from flows.service.guard import rules_for
from flows.service.serve import Guard

KEY = "modelgap:a-key-of-thirty-two-letters-or-more"
_RULES = rules_for("127.0.0.1", 4200, KEY)
_HOST, _OWN = "127.0.0.1:4200", "http://127.0.0.1:4200"
_HOSTS = (
    *("", "127.0.0.1", "127.0.0.1:4201", "0.0.0.0:4200", "2130706433:4200"),
    *("evil.example:4200", "127.0.0.1.evil.example:4200", "evil@127.0.0.1:4200"),
    *("127.0.0.1:4200 evil.example", "[::ffff:127.0.0.1]:4200"),
)
_ORIGINS = (
    *("", "null", "file://", "http://evil.example", "http://evil.example:4200"),
    *("https://127.0.0.1:4200", "http://127.0.0.1", "http://127.0.0.1:42000"),
    *("http://127.0.0.1:4200.evil.example", "http://localhost:4200"),
    "http://127.0.0.1:4200, http://evil.example",
)
_FORMS = ("application/x-www-form-urlencoded", "multipart/form-data")
_KINDS = (None, "text/plain", *_FORMS)
_KEYS = (None, "", "modelgap:", "modelgap:wrong", KEY[:-1], KEY + "x", KEY.upper())


def requests() -> Iterator[tuple[str, dict, bool]]:
    """Give name, request as ASGI has it, and whether it is to be let through."""
    own, json = ("origin", _OWN), ("content-type", "application/json")
    body, key = ("content-length", "12"), _signed(KEY)
    yield "own page", scope_of("POST", own, key, json, body), True
    yield "own page, no key", scope_of("POST", own, json, body), False
    yield "own program", scope_of("POST", key, json, body), True
    yield "own reading", scope_of("GET"), True
    for host in _HOSTS:
        yield f"Host {host!r}", scope_of("GET", host=host), False
        yield f"Host {host!r}, key", scope_of("POST", key, json, body, host=host), False
        events = scope_of("GET", host=host, kind="websocket")
        yield f"Host {host!r}, events", events, False
    for origin in _ORIGINS:
        given = ("origin", origin)
        for method in ("GET", "POST", "DELETE", "OPTIONS"):
            told = f"{method} from {origin!r}"
            yield told, scope_of(method, given, json, body, key), False
        yield f"events for {origin!r}", scope_of("GET", given, kind="websocket"), False
        two = scope_of("POST", own, given, key, json, body)
        yield f"two pages, {origin!r}", two, False
    for kind in _KINDS:
        given = () if kind is None else (("content-type", kind),)
        yield f"body of {kind}", scope_of("POST", own, key, *given, body), False
        yield f"body of {kind}, key", scope_of("POST", key, *given, body), False
        twice = scope_of("PUT", own, key, json, *(given or (json,)), body)
        yield f"JSON and {kind}", twice, False
    for word in _KEYS:
        given = () if word is None else (_signed(word),)
        for method in ("POST", "PUT", "PATCH", "DELETE"):
            told = f"{method} with key {word!r}"
            yield told, scope_of(method, *given, json, body), False


def let_through(asked: dict) -> bool:
    """Return whether a request reaches what is behind the guard."""
    reached = False
    # Of a WebSocket that is open what counts is whether its first message comes in.
    with_messages = "sent" in asked
    sent = iter(asked.get("sent", ()))

    async def behind(scope, receive, send) -> None:
        nonlocal reached
        first = await receive() if with_messages else {}
        reached = first.get("type") != "websocket.disconnect"

    async def receive() -> dict:
        return next(sent, {"type": "websocket.connect"})

    async def send(message: dict) -> None:
        pass

    asyncio.run(Guard(behind, _RULES)(asked, receive, send))
    return reached


def _signed(key: str) -> tuple[str, str]:
    return "authorization", f"Basic {b64encode(key.encode()).decode()}"


def scope_of(method: str, *given, host: str = _HOST, kind: str = "http") -> dict:
    """Return a request or an opening WebSocket as ASGI has it."""
    headers = [("host", host), *given]
    return {
        "type": kind,
        "method": method,
        "path": "/api/flows/",
        "query_string": b"",
        "headers": [(k.encode(), v.encode()) for k, v in headers],
    }


# What TOML may say in place of any value; a table or a day is right nowhere.
_BAD = {
    "not a number": "nan",
    "below": "-1",
    "far too large": "1e308",
    "more than 64 bits": "9" * 400,
    "no word": '""',
    "a strange word": '"\\u202e \\u001b[31m"',
    "a table": "{x = 1}",
    "a day": "2026-01-01",
    "nothing": "[]",
}
_NOWHERE = ("a table", "a day", "more than 64 bits")
_SIX = "[1, 1, 1, 1, 1, 1]"


def _names(signal: str) -> str:
    return "[" + ", ".join(f'"{signal}{j}"' for j in range(1, 7)) + "]"


MAP = {
    "time": {"column": '"t"', "unit": '"s"', "scale": "1.0"},
    "q": {
        "columns": _names("q"),
        "unit": '"rad"',
        "side": '"link"',
        "sign": _SIX,
        "zero": "[0, 0, 0, 0, 0, 0]",
        "scale": _SIX,
    },
    "tau": {"columns": _names("tau"), "unit": '"N m"', "side": '"link"', "sign": _SIX},
    "csv": {"separator": '","', "decimal": '"."', "skip": "0"},
}
SPEC = {
    "trajectory": {"kind": '"cyclic"', "duration": "4.0", "periods": "1"},
    "plant": {"scatter": "0.02", "noise": "{torque = 0.01, encoder = 1e-4}"},
    "rates": {"control": "1000", "log": "250"},
}
EFFECT = {"name": '"stribeck"', "joints": "[3]", "level": "4.0", "velocity": "0.05"}


def text_of(tables: dict[str, dict[str, str]], head: str = "") -> str:
    lines = [head]
    for name, keys in tables.items():
        lines += [f"[{name}]", *(f"{key} = {value}" for key, value in keys.items())]
    return "\n".join(lines) + "\n"


def bad_maps() -> Iterator[tuple[str, bytes, bool]]:
    """Give name, text and whether none may take it, of maps with one bad value."""
    yield from _each(MAP, lambda tables: text_of(tables))


def bad_specs() -> Iterator[tuple[str, bytes, bool]]:
    head = 'schema = 1\nrobot = "irb140"\nseed = 7\n'
    whole = {**SPEC, "[plant.effect]": EFFECT}
    yield from _each(whole, lambda tables: text_of(tables, head))
    for key in ("schema", "robot", "seed"):
        for name, bad in _BAD.items():
            own = re.sub(f"{key} = .*", lambda _, k=key, b=bad: f"{k} = {b}", head)
            yield f"{key}: {name}", text_of(SPEC, own).encode(), name in _NOWHERE


def _each(tables: dict, write) -> Iterator[tuple[str, bytes, bool]]:
    for table, keys in tables.items():
        for key in keys:
            for name, bad in _BAD.items():
                changed = {**tables, table: {**keys, key: bad}}
                text = write(changed).encode()
                yield f"{table}.{key}: {name}", text, name in _NOWHERE


_ATTRIBUTES = (
    '(<mass value)="[^"]*"',
    '(<inertia[^>]* ixx)="[^"]*"',
    '(<axis xyz)="[^"]*"',
    '(<limit[^>]* lower)="[^"]*"',
    '(<limit[^>]* velocity)="[^"]*"',
    '(<limit[^>]* effort)="[^"]*"',
    '(<parent link)="[^"]*"',
    '(<child link)="[^"]*"',
    '(<joint name)="[^"]*"',
    '(<joint[^>]* type)="[^"]*"',
    '(<link name)="[^"]*"',
)
_WORDS = ("", "nan", "-inf", "1e308", "0 0", "&#27;[31m", "none such", "9" * 400)


def bad_robots(good: str) -> Iterator[tuple[str, bytes, bool]]:
    """Give URDFs of which one attribute is not as it may be, or missing."""
    for pattern in _ATTRIBUTES:
        name = pattern.strip("(<").split(")")[0].replace("[^>]*", "").strip()
        for word in _WORDS:
            told = f"{name} = {word[:12]!r}"
            text = re.sub(
                pattern, lambda m, w=word: f'{m[1]}="{w}"', good, count=1, flags=re.S
            )
            yield told, text.encode(), False
        text = re.sub(pattern, lambda m: m[1].rsplit(" ", 1)[0], good, count=1)
        yield f"{name} missing", text.encode(), False


def bad_logs(good: str) -> Iterator[tuple[str, bytes, bool]]:
    """Give logs of which one column is not as it may be."""
    header, *lines = good.splitlines()
    names, rows = header.split(","), [line.split(",") for line in lines]
    for name in ("t", "q1", "tau6"):
        at = names.index(name)
        column = [row[at] for row in rows]
        for what, (other, none) in _columns(column, name == "t").items():
            body = [
                [*row[:at], value, *row[at + 1 :]]
                for row, value in zip(rows, other, strict=True)
            ]
            text = "\n".join([header, *(",".join(row) for row in body)])
            yield f"{name} {what}", text.encode(), none
        for what, word in _HEADS.items():
            head = ",".join([*names[:at], word, *names[at + 1 :]])
            yield f"{name} {what}", "\n".join([head, *lines]).encode(), True


_HEADS = {
    "has no name": "",
    "is called as another": "q2",
    "has a name of escapes": "\x1b[31m",
    "has a name of 60 000 letters": "x" * 60_000,
}


def _columns(column: list[str], time: bool) -> dict[str, tuple[list[str], bool]]:
    """What a column may hold instead, and whether none may take it."""
    n, values = len(column), np.array(column, dtype=float)
    words = {
        "is empty": "",
        "is nan": "nan",
        "is infinite": "inf",
        "is beyond all numbers": "1e999",
        "is words": "abc",
        "is true": "true",
        "is days": "2026-01-01T00:00:00",
        "is hexadecimal": "0x1f",
    }
    out = {what: ([word] * n, True) for what, word in words.items()}
    half = n // 2
    for what, word in words.items():
        once = [*column[:half], word, *column[half + 1 :]]
        out[f"{what} once"] = once, what in ("is words", "is days")
    moved = {
        "stands still": np.full(n, values[0]),
        "runs backwards": values[::-1],
        "is a million times that": 1e6 * values,
    }
    for what, other in moved.items():
        out[what] = (
            [f"{x:.9g}" for x in other],
            time and what != "is a million times that",
        )
    return out
