"""Robots by name or file; a rerun may say that another file stands for one of them."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from flows.inputs.logs import is_run
from flows.settings import store_folder
from residual.effects import registry, vocabulary
from residual.errors import InputError
from residual.lazy import Lazy
from residual.names import check_name, shortened
from residual.robot.robot import Robot, load_robot, with_serial

origin = Lazy("warehouse.robots")
stored = Lazy("warehouse.runs")

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
    manifest = stored.read_manifest(store, runs[0])
    if "spec" not in manifest:
        return origin.robot_of_hash(store, manifest["robot_hash"])
    return manifest.get("robot") or manifest["spec"]["robot"]["name"]


def load_of(word: str, runs: Sequence[str], store: str | Path | None) -> Robot:
    """Load the robot of some runs, with the serial number that they were stored with.

    Args:
        word: Built-in name, URDF file or folder; it may say no serial number.
        runs: Logs of one arm; only those that are ids of runs are asked.
        store: The store, None for the usual one.

    Raises:
        InputError: If the runs are of arms with different serial numbers, or of another
            one than robot.toml says; or there is no such run.
    """
    robot = load(word)
    for run in filter(is_run, runs):
        serial = serial_of(run, store)
        if serial is not None and robot.serial not in (None, serial):
            raise InputError(
                f"Run {run} is of {robot.name} {serial}, expected one of {robot.name} "
                f"{robot.serial} like the rest. Give runs of one arm."
            )
        robot = with_serial(robot, serial)
    return robot


def serial_of(run: str, store: str | Path | None) -> str | None:
    """Return the serial number of the arm of a run, None where it has none.

    Raises:
        InputError: If there is no such run.
    """
    return stored.read_manifest(store_folder(store), run).get("serial")


def known_of(words: Sequence[str]) -> dict[str, float]:
    """Return the values of --known, such as "payload.mass=2.8", by name.

    Raises:
        InputError: If one is no name and number.
    """
    out = {}
    for word in words:
        name, equals, text = word.partition("=")
        try:
            out[name.strip()] = float(text)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(
                f"--known '{shortened(word)}': expected NAME.PARAMETER=NUMBER, such as "
                "payload.mass=2.8 or coulomb.2.level=8."
            )
    return out


def check_declared(names: Sequence[str] | None) -> None:
    """Refuse names in --declared that no effect has.

    Raises:
        UnknownNameError: With the nearest one.
    """
    for name in names or ():
        check_name(name, registry(), "effect in --declared")
