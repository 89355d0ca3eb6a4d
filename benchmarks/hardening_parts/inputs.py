"""Hostile inputs in a table; each is answered or refused, and nothing else.

What a command makes of one input is judged beside it: whether an answer is right.
"""

import csv
import io
import multiprocessing
import os
import sys
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from benchmarks.hardening_parts.hostile import TABLE, prepare
from benchmarks.hardening_parts.http import let_through
from benchmarks.hardening_parts.strangers import Input
from benchmarks.harness.figures import Figures, all_partial, figure
from benchmarks.store_parts.made import folder
from flows.cli import main
from warehouse.layout import list_folders
from warehouse.runs import read_run


def outcome_of(place: Path, given: Input, out: Connection) -> None:
    """Run one command in a folder of its own; to be called in a child."""
    os.chdir(place)
    if given.request is not None:
        out.send((0 if let_through(given.request) else 2, "", ""))
        return
    own = {} if given.content is None else {given.file: given.content}
    for name, content in {**(given.beside or {}), **own}.items():
        Path(name).parent.mkdir(exist_ok=True)
        if content is None:
            Path(name).symlink_to(name)
        else:
            Path(name).write_bytes(content)
    # What a library prints by itself is a part of the answer too.
    sys.stdin = io.StringIO()
    printed, told = io.StringIO(), io.StringIO()
    with redirect_stdout(printed), redirect_stderr(told):
        code = main(list(given.words))
    out.send((code, printed.getvalue(), told.getvalue()))


def judged(place: Path, given: Input, out: str) -> bool:
    """Return whether an answer may be right; True where nobody can say."""
    if given.judge == "refuse":
        return False
    if given.judge == "inbox":
        return any(each.is_file() for each in (place / "in").glob("done*/z.csv"))
    if given.judge == "samples":
        return _same_samples(place, given.content, _LEFT_OUT in out)
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


LONGEST = 30.0  # seconds
_COMMANDS = tuple(
    f"flows.cli.{name}"
    for name in ("logs", "experiment", "sql", "history", "project", "diagnose", "store")
)


def input_figures(quick: bool) -> Figures:
    """Give every input to its command in a process of its own."""
    each = 8 if quick else None
    for module in _COMMANDS:  # once here, not in every child
        import_module(module)
    with folder() as place:
        base = prepare(place)
        chosen = [i for kind in TABLE for i in _some(TABLE[kind](base), each)]
        told: dict[str, list[str]] = {"traceback": [], "hang": [], "wrong": []}
        seen: Counter = Counter()
        for number, given in enumerate(chosen):
            outcome = _answered(place / f"at-{number}", given)
            seen[given.kind, outcome] += 1
            if outcome in told:
                told[outcome].append(f"{given.kind} {given.name}")
    count, checked = len(chosen), sum(given.judge is not None for given in chosen)
    refused = sum(n for (_, outcome), n in seen.items() if outcome == "refused")
    kinds = Counter(given.kind for given in chosen)
    stops = [each for names in told.values() for each in names if "inbox" in each[:5]]
    figures = {
        "inbox_stops": figure(len(stops), 0, kinds["inbox"], told=stops[:9]),
        "inputs_traceback": figure(
            len(told["traceback"]), 0, count, told=told["traceback"][:9], kinds=kinds
        ),
        "inputs_hang": figure(len(told["hang"]), 0, count, told=told["hang"][:9]),
        "inputs_silently_wrong": figure(
            len(told["wrong"]), 0, checked, told=told["wrong"][:9], refused=refused
        ),
    }
    return all_partial(figures, f"{count} of the inputs" if quick else "")


def _some(inputs: list[Input], each: int | None) -> list[Input]:
    if each is None or len(inputs) <= each:
        return inputs
    return inputs[:: -(-len(inputs) // each)]


def _answered(place: Path, given: Input) -> str:
    """Return "answered", "refused", or what went wrong."""
    place.mkdir()
    context = multiprocessing.get_context("fork")
    mine, theirs = context.Pipe(duplex=False)
    process = context.Process(target=outcome_of, args=(place, given, theirs))
    process.start()
    theirs.close()
    try:
        if not mine.poll(LONGEST):
            return "hang"
        try:
            code, out, err = mine.recv()
        except EOFError:  # the process ended by a signal
            return "traceback"
    finally:
        process.kill()
        process.join()
    if code not in (0, 2) or "Traceback" in err or "unexpected failure" in err:
        return "traceback"
    if code == 2:
        return "wrong" if given.judge == "answer" else "refused"
    return "answered" if judged(place, given, out) else "wrong"
