"""What a stranger may leave lying about: names, rows, large bodies."""

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.hardening_parts.http import KEY, scope_of

LONG = "x" * 5000
NAMES = ("t", *(f"{c}{j}" for c in ("q", "tau") for j in range(1, 7)))
PROJECT = """schema = 1
[[robot]]
name = "cell"
urdf = "irb140"
[[inbox]]
robot = "cell"
folder = "in"
quiet = 0
"""


@dataclass(frozen=True, slots=True)
class Input:
    """One hostile input."""

    kind: str
    name: str
    words: tuple[str, ...]
    file: str = ""
    content: bytes | None = None  # content of the file; None for no file
    # How an answer is judged: "refuse" for none is right, "answer" for only one is,
    # "samples", "inbox" for the log beside it is stored, or None where nobody
    # can say
    judge: str | None = None
    answer: str | None = None
    # What is asked of the guard of a server, in place of a command
    request: dict | None = None
    # Other files by name; None for a link to itself
    beside: Mapping[str, bytes | None] | None = None


def of_names(base: Mapping[str, Path]) -> list[Input]:
    """Give names that no file can have to commands that take one."""
    log = str(base["log"])
    commands = (
        ("check", "{}", "--robot", "irb140"),
        ("check", log, "--robot", "{}"),
        ("check", log, "--robot", "irb140", "--map", "{}"),
        ("diagnose", "{}", "--robot", "irb140"),
        ("experiment", "{}", "--dry-run"),
        ("runs", "--store", "{}"),
        ("sql", "SELECT 1", "--out", "{}"),
    )
    names = {"link": "loop.csv", "long": LONG, "long part": f"a/{LONG}/b.csv"}
    return [
        Input(
            "name",
            f"{what} {words[0]}",
            tuple(word.format(name) for word in words),
            judge="refuse",
            beside={"loop.csv": None},
        )
        for words in commands
        for what, name in names.items()
    ]


def of_inboxes(base: Mapping[str, Path]) -> list[Input]:
    """Give logs of strange names to an inbox in which a good one lies too."""
    good = base["log"].read_bytes()
    names = {
        "long": b"a" * 251 + b".csv",
        "long, not ASCII": "ä".encode() * 125 + b".csv",
        "no UTF-8": b"\xff\xfe.csv",
        "escapes": b"\x1b[31mred.csv",
        "line end": b"a\nb.csv",
        "an option": b"--help",
        "a window": b"a@0:1.csv",
        "done": b"done",
        "rejected": b"rejected",
    }
    bodies = {"good": good.replace(b"\n0", b"\n1e-9", 1), "bad": b"t,q1\n0,1\n"}
    return [
        Input(
            "inbox",
            f"{name}, {what}",
            ("inbox", "--once", "--import-only"),
            f"in/{os.fsdecode(raw)}",
            content,
            "inbox",
            beside={"modelgap.toml": PROJECT.encode(), "in/z.csv": good},
        )
        for name, raw in names.items()
        for what, content in bodies.items()
    ]


def of_tables(base: Mapping[str, Path]) -> list[Input]:
    """Give logs that unfold, or whose clock is none."""
    given = ("--robot", "irb140")
    out = []
    for millions in (5, 20):
        words = ("check", "bomb.parquet", *given)
        bomb = _bomb(millions)
        name = f"{millions} million rows"
        out.append(Input("table", name, words, "bomb.parquet", bomb, "refuse"))
    header, *lines = base["log"].read_text().splitlines()
    for step in ("1e-12", "1e-17", "1e-300"):
        rows = (
            f"{i * float(step)!r},{r.split(',', 1)[1]}" for i, r in enumerate(lines)
        )
        text = "\n".join([header, *rows]).encode()
        for words in (("import",), ("diagnose",), ("diagnose", "--trust-log")):
            name = f"steps of {step} s, {' '.join(words)}"
            words = (*words, "log.csv", *given)
            out.append(Input("table", name, words, "log.csv", text, "refuse"))
    return out


def _bomb(millions: int) -> bytes:
    part = pa.table({name: np.zeros(1_000_000) for name in NAMES})
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, part.schema, compression="zstd") as file:
        for _ in range(millions):
            file.write_table(part)
    return sink.getvalue().to_pybytes()


def requests() -> Iterator[tuple[str, dict, bool]]:
    """Give what is too much, or no text, before the key was shown."""
    own = ("origin", "http://127.0.0.1:4200")
    json_body = ("content-type", "application/json")
    for place in ("/pages/index.html", "/api/flows/"):
        asked = scope_of("POST", own, json_body) | {"path": place}
        yield f"400 MB to {place}", asked | {"sent": _parts(400)}, False
    words = {
        "half a character": '{"type": "auth", "token": "\\ud800"}',
        "a number": '{"type": "auth", "token": 7}',
        "a list": "[]",
        "brackets": "[" * 100_000,
        "3 MB": json.dumps({"type": "auth", "token": KEY, "more": "x" * 3_000_000}),
    }
    for what, text in words.items():
        message = {"type": "websocket.receive", "text": text}
        asked = scope_of("GET", kind="websocket") | {"sent": [message]}
        yield f"first message is {what}", asked, False
    shown = json.dumps({"type": "auth", "token": KEY})
    message = {"type": "websocket.receive", "text": shown}
    yield ("the key", scope_of("GET", kind="websocket") | {"sent": [message]}, True)


def _parts(count: int) -> Iterator[dict]:
    for part in range(count):
        more = part + 1 < count
        yield {"type": "http.request", "body": b" " * (1 << 20), "more_body": more}
