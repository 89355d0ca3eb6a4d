"""Descriptions of robots that do not come with the program, kept with their runs.

``robots/sha256=<hash>/<name>.urdf`` and, where there was one, ``robot.toml``; the hash
is that of the robot (``Robot.content_hash``). So a run can be made again where the file
that described its robot has changed or is not at hand.
"""

import json
import re
import shutil
import tomllib
from functools import lru_cache
from pathlib import Path

from residual.errors import InputError, ModelgapError
from residual.robot.robot import (
    Robot,
    built_in_folder,
    built_in_robots,
    load_robot,
)
from warehouse.files import publish, staged
from warehouse.mirror import brought, is_there, shown

ROBOTS, TOML = "robots", "robot.toml"


def keep_robot(store: Path, word: str, robot: Robot) -> None:
    """Put the description of a robot into the store, unless it is built in."""
    target = robot_folder(store, robot.content_hash)
    if is_there(target) or _is_built_in(word, robot):
        return
    path = Path(str(built_in_folder(word))) if word in built_in_robots() else Path(word)
    urdf = path if path.is_file() else next(path.glob("*.urdf"), path)
    with staged(store, "robot") as folder:
        try:
            shutil.copyfile(urdf, folder / f"{robot.name}.urdf")
            text = _toml_text(path, robot)
            if text is not None:
                (folder / TOML).write_text(text, encoding="utf-8")
            kept = load_robot(folder)
        except (OSError, ModelgapError):
            return
        # Edited since it was loaded: then there is nothing to keep.
        if (kept.content_hash, kept.name) == (robot.content_hash, robot.name):
            publish(folder, target)


def _is_built_in(word: str, robot: Robot) -> bool:
    known = word in built_in_robots()
    return known and load_robot(word).content_hash == robot.content_hash


def _toml_text(path: Path, robot: Robot) -> str | None:
    """The robot.toml of a robot, which says its serial number too; None for none."""
    own = path / TOML if path.is_dir() else None
    text = own.read_text(encoding="utf-8") if own and own.is_file() else None
    if robot.serial is None or "serial" in tomllib.loads(text or "").get("robot", {}):
        return text
    line = f"serial = {json.dumps(robot.serial)}\n"
    table = re.search(r"^\[robot\][^\n]*\n", text or "", re.MULTILINE)
    if table:
        return text[: table.end()] + line + text[table.end() :]
    return f"[robot]\n{line}\n{text or ''}"


def robot_of_hash(store: Path, content_hash: str) -> str:
    """Return the word for the robot of a hash: a built-in name, or its kept folder."""
    for name in built_in_robots():
        if load_robot(name).content_hash == content_hash:
            return name
    folder = robot_folder(store, content_hash)
    if brought(folder):
        return str(folder)
    raise InputError(
        f"No description of the robot {content_hash[:8]} was kept in {shown(store)}. "
        "Import a log of it again with --robot, which keeps it."
    )


def robot_word(store: Path, word: str, content_hash: str | None) -> str:
    """Return what to load a robot from, such that it is the one that was used.

    Args:
        content_hash: Its hash then; None where that is not known.

    Returns:
        The same word, or the folder in the store with its description.

    Raises:
        InputError: If neither is the robot that was used.
    """
    try:
        if content_hash in (None, load_robot(word).content_hash):
            return word
        why = f"{word} describes another robot now"
    except ModelgapError as error:
        why = str(error)
    kept = robot_folder(store, content_hash or "")
    if brought(kept) and _hash(str(kept)) == content_hash:
        return str(kept)
    raise InputError(
        f"The robot that this was made with is not here: {why} And no description of "
        "it was kept in the store. Put back the URDF and robot.toml of that time."
    )


def robot_folder(store: Path, content_hash: str) -> Path:
    """Return where a description is kept."""
    if len(content_hash) != 64 or set(content_hash) - set("0123456789abcdef"):
        raise InputError(f"'{content_hash}' is not the hash of a robot.")
    return store / ROBOTS / f"sha256={content_hash}"


@lru_cache(maxsize=8)
def _hash(folder: str) -> str | None:
    try:
        return load_robot(folder).content_hash
    except ModelgapError:
        return None
