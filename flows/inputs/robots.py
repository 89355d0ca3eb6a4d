"""Robots by name or file; a rerun may say that another file stands for one of them."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from residual.effects import registry, vocabulary
from residual.errors import InputError
from residual.names import check_name
from residual.robot.robot import Robot, load_robot
from warehouse.runs import read_manifest

_INSTEAD: ContextVar[Mapping[str, str]] = ContextVar("instead", default={})  # noqa: B039


def load(word: str) -> Robot:
    """Load a robot: built-in name, URDF file or folder.

    Raises:
        RobotError: If there is no such robot or it is not usable.
        UnknownNameError: If it declares an effect or a parameter that is not known.
    """
    return load_robot(_INSTEAD.get().get(word, word), vocabulary())


@contextmanager
def instead(words: Mapping[str, str]) -> Iterator[None]:
    """Load other files than the words say, for the time being.

    Args:
        words: Where to look, by what a robot is called.
    """
    token = _INSTEAD.set(words)
    try:
        yield
    finally:
        _INSTEAD.reset(token)


def robot_of(runs: Sequence[str], store: Path) -> str:
    """Return the name or file of the robot of some runs.

    Raises:
        InputError: If there is no run, or it is not in the store.
    """
    if not runs:
        raise InputError("No run given, expected one or more ids.")
    manifest = read_manifest(store, runs[0])
    return manifest.get("robot") or manifest["spec"]["robot"]["name"]


def check_declared(names: Sequence[str] | None) -> None:
    """Refuse names in --declared that no effect has.

    Raises:
        UnknownNameError: With the nearest one.
    """
    for name in names or ():
        check_name(name, registry(), "effect in --declared")
