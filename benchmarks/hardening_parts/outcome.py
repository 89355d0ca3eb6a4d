"""What a command makes of one input, and whether an answer to it is right."""

import csv
import io
import os
import sys
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from benchmarks.hardening_parts.hostile import Input
from benchmarks.hardening_parts.http import let_through
from benchmarks.hardening_parts.made import damaged
from flows.cli import main
from warehouse.layout import list_folders
from warehouse.runs import read_run


def outcome_of(place: Path, given: Input, out: Connection) -> None:
    """Run one command in a folder of its own; to be called in a child."""
    os.chdir(place)
    if given.request is not None:
        out.send((0 if let_through(given.request) else 2, "", ""))
        return
    if given.content is not None:
        Path(given.file).write_bytes(given.content)
    # What a library prints by itself is a part of the answer too.
    sys.stdin = io.StringIO()
    printed, told = io.StringIO(), io.StringIO()
    with redirect_stdout(printed), redirect_stderr(told):
        code = main(list(given.words))
    out.send((code, printed.getvalue(), told.getvalue()))


def judged(place: Path, given: Input, out: str, base: Mapping[str, Path]) -> bool:
    """Return whether an answer may be right; True where nobody can say."""
    if given.judge == "refuse":
        return False
    if given.judge == "samples":
        return _same_samples(place, given.content, _LEFT_OUT in out)
    if given.judge == "bundle":
        store = place / "store"
        known = list_folders(base["origin"], "runs")
        return not damaged(store) and set(list_folders(store, "runs")) <= set(known)
    return given.answer is None or given.answer in out


# How the log check says that rows were left out.
_LEFT_OUT = "samples are such"


def _believable(names: list[str], body: list[list[str]]) -> list[list[str]]:
    """Return the rows with numbers that a sensor may have written."""
    read = ("t", *(f"{c}{j}" for c in ("q", "tau") for j in range(1, 7)))
    places = [names.index(name) for name in read]
    table = np.array([[float(row[p] or "nan") for p in places] for row in body])
    kept = (np.abs(table) < 1e30).all(axis=1)
    return [row for row, keep in zip(body, kept, strict=True) if keep]


def _same_samples(place: Path, content: bytes, fewer: bool) -> bool:
    """Whether the run that was stored has the numbers of the file, read otherwise."""
    store = place / "store"
    (id,) = list_folders(store, "runs")
    got = read_run(store, id)
    text = content.decode("utf-8-sig", errors="replace")
    rows = list(csv.reader(io.StringIO(text, newline=None)))
    names = [name.strip() for name in rows[0]]
    body = [row for row in rows[1:] if row]
    if fewer:
        body = _believable(names, body)
    for name, values in (("t", got.t[:, None]), ("q", got.q), ("tau", got.tau)):
        wanted = [name] if name == "t" else [f"{name}{j}" for j in range(1, 7)]
        places = [names.index(each) for each in wanted]
        table = np.array([[float(row[p]) for p in places] for row in body])
        table = table - table[0] if name == "t" else table
        values = values - values[0] if name == "t" else values
        if table.shape != values.shape or not np.array_equal(table, values):
            return False
    return True
