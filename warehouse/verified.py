"""One verified thing of a store, and checks of what is no record."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from residual.errors import ModelgapError


@dataclass(frozen=True, slots=True)
class Verified:
    """One thing in a store.

    Attributes:
        kind: Kind of record, or the folder of the store that it is in.
        id: Its id, or the name of its file.
        faults: What is not as it was committed, a line each.
        summed: Whether every byte of it was held against a sum; otherwise its values
            were held against the hash in its record, which an earlier version wrote.
    """

    kind: str
    id: str
    faults: tuple[str, ...]
    summed: bool = True


def told(check: Callable, *about: object) -> tuple[str, ...]:
    """Return what a check says against something, whatever is wrong with it."""
    try:
        check(*about)
    except (ModelgapError, OSError, ValueError, KeyError, RecursionError) as error:
        return (" ".join(str(error).split()),)
    return ()


def check_robot(folder: Path, load: Callable) -> None:
    """Check that a kept robot is the one that its folder names.

    Raises:
        ValueError: If it is another.
    """
    if load(folder).content_hash != folder.name.removeprefix("sha256="):
        raise ValueError(f"{folder.name} describes another robot than its name says")


def check_tombstone(name: str, content: bytes) -> None:
    """Check that a tombstone is about the run that its name says.

    Raises:
        ValueError: If it is about another.
    """
    told = json.loads(content)
    if f"run_id={told['run_id']}.json" != name:
        raise ValueError(f"{name} is about another run than its name says")
