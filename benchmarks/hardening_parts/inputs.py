"""Hostile inputs in a table; each is answered or refused, and nothing else."""

import multiprocessing
from collections import Counter
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from benchmarks.figures import Figures, figure, partial
from benchmarks.hardening_parts.hostile import TABLE, Input, prepare
from benchmarks.hardening_parts.outcome import judged, outcome_of
from benchmarks.store_parts.made import folder

LONGEST = 30.0  # seconds
_COMMANDS = tuple(
    f"flows.cli.{name}" for name in ("imports", "check", "experiment", "sql", "bundle")
)


def input_figures(each: int | None) -> Figures:
    """Give every input to the command that reads it, each in a process of its own.

    Args:
        each: How many of each kind of input, spread over the table; None for all.
    """
    for module in _COMMANDS:  # once here, not in every child
        import_module(module)
    with folder() as place:
        base = prepare(place)
        chosen = [i for kind in TABLE for i in _some(TABLE[kind](base), each)]
        told: dict[str, list[str]] = {"traceback": [], "hang": [], "wrong": []}
        seen: Counter = Counter()
        for number, given in enumerate(chosen):
            outcome = _answered(place / f"at-{number}", given, base)
            seen[given.kind, outcome] += 1
            if outcome in told:
                told[outcome].append(f"{given.kind} {given.name}")
    count, checked = len(chosen), sum(given.judge is not None for given in chosen)
    refused = sum(n for (_, outcome), n in seen.items() if outcome == "refused")
    kinds = Counter(given.kind for given in chosen)
    figures = {
        "inputs_traceback": figure(
            len(told["traceback"]), 0, count, told=told["traceback"][:9], kinds=kinds
        ),
        "inputs_hang": figure(len(told["hang"]), 0, count, told=told["hang"][:9]),
        "inputs_silently_wrong": figure(
            len(told["wrong"]), 0, checked, told=told["wrong"][:9], refused=refused
        ),
    }
    if each is None:
        return figures
    why = f"{count} of the inputs"
    return {name: partial(entry, why) for name, entry in figures.items()}


def _some(inputs: list[Input], each: int | None) -> list[Input]:
    if each is None or len(inputs) <= each:
        return inputs
    return inputs[:: -(-len(inputs) // each)]


def _answered(place: Path, given: Input, base: Mapping[str, Path]) -> str:
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
    return "answered" if judged(place, given, out, base) else "wrong"
