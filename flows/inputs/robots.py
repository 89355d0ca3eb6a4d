"""Robots by name or file; a rerun may say that another file stands for one of them."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

from residual.effects import vocabulary
from residual.robot.robot import Robot, load_robot

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
