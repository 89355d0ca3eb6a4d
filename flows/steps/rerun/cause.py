"""Why a rerun gave other values: the most probable cause, from what is on record."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from warehouse.provenance import read_packages

CODE = "code"
ENVIRONMENT = "environment"
MACHINE = "machine"
SPEC = "seed or spec"
DAMAGED = "damaged"
CHANCE = "nondeterminism"
_MANY = 6  # packages that are named; the others are counted


@dataclass(frozen=True, slots=True)
class Cause:
    """Why values differ.

    Attributes:
        kind: code, environment, machine, seed or spec, damaged or nondeterminism.
        why: The evidence, in one line.
    """

    kind: str
    why: str


def cause_of(
    then: Mapping, now: Mapping, key: str, faults: tuple[str, ...], store: Path
) -> Cause:
    """Return the most probable cause of a difference.

    Args:
        key: Which hash of code counts: code_hash for runs, program_hash for others.
        faults: What is not as it was committed (``warehouse.verify.faults``).
        store: The store, which may have the list of packages of that time.
    """
    if faults:
        spec = any("spec is not the one" in fault for fault in faults)
        return Cause(SPEC if spec else DAMAGED, "; ".join(faults))
    if then.get(key) != now[key]:
        return Cause(CODE, _code(then, now, key))
    apart = environment_apart(then, now, store)
    if apart:
        return Cause(ENVIRONMENT, _listed(apart))
    if then.get("machine") not in (None, now["machine"]):
        return Cause(MACHINE, f"made on {then['machine']}, now on {now['machine']}")
    return Cause(CHANCE, "code, environment, machine, spec and seeds are the same")


def environment_apart(
    then: Mapping, now: Mapping, store: Path
) -> dict[str, tuple[str | None, str | None]]:
    """Return the packages whose version differs: then and now, by name."""
    if then.get("environment_hash") == now.get("environment_hash"):
        listed = ({}, {})
    else:
        listed = tuple(read_packages(store, side) for side in (then, now))
    if None in listed:
        listed = ({}, {})
    before, after = (
        {**(side.get("versions") or {}), **packages}
        for side, packages in zip((then, now), listed, strict=True)
    )
    # Those that compute first: the others seldom change a number.
    names = [*(then.get("versions") or {}), *sorted({*before, *after})]
    apart = {
        name: (before.get(name), after.get(name))
        for name in dict.fromkeys(names)
        if before.get(name) != after.get(name)
    }
    if not apart and then.get("environment_hash") != now.get("environment_hash"):
        return {"other packages": ("not on record", "not on record")}
    return apart


def _code(then: Mapping, now: Mapping, key: str) -> str:
    what = "the plant's code" if key == "code_hash" else "the program's code"
    commits = [(side.get("commit") or "unknown")[:12] for side in (then, now)]
    told = f"{what} was {_short(then.get(key))} (commit {commits[0]}"
    return f"{told}), is {_short(now[key])} (commit {commits[1]})"


def _short(hash: str | None) -> str:
    return hash[:12] if hash else "not on record"


def _listed(apart: Mapping) -> str:
    words = [
        f"{name} {old or 'none'} -> {new or 'none'}"
        for name, (old, new) in list(apart.items())[:_MANY]
    ]
    more = len(apart) - len(words)
    return ", ".join([*words, *([f"{more} more"] if more > 0 else [])])
