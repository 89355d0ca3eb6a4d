"""Descriptions of robots that do not come with the program, kept with their runs.

``robots/sha256=<hash>/<name>.urdf`` and, where there was one, ``robot.toml``; the hash
is that of the robot (``Robot.content_hash``). So a run can be made again where the file
that described its robot has changed or is not at hand.
"""

import json
import re
import tomllib
from functools import lru_cache
from pathlib import Path

import tomli_w

from residual.errors import InputError, ModelgapError
from residual.robot.robot import (
    Robot,
    find_built_in_folder,
    list_built_in_robots,
    load_robot,
    parse_robot_reference,
)
from warehouse.remote_store import fetch_record, format_store_name, record_exists
from warehouse.store_files import create_staging_folder, publish_folder

ROBOTS, TOML = "robots", "robot.toml"


def store_robot_description(store: Path, reference: str, robot: Robot) -> None:
    """Put the description of a robot into the store, unless it is built in."""
    target = build_robot_path(store, robot.content_hash)
    built_in = reference in list_built_in_robots()
    place = Path(parse_robot_reference(reference)[0])
    if record_exists(target) or (
        built_in and load_robot(reference).content_hash == robot.content_hash
    ):
        return
    path = Path(str(find_built_in_folder(reference))) if built_in else place
    with create_staging_folder(store, "robot") as folder:
        try:
            # The arm only: files with several arms, xacro and MJCF are stored as its URDF.
            urdf = folder / f"{robot.name}.urdf"
            urdf.write_text(robot.urdf, encoding="utf-8")
            text = _toml_text(path, robot)
            if text is not None:
                (folder / TOML).write_text(text, encoding="utf-8")
            kept = load_robot(folder)
        except (OSError, ModelgapError):
            return
        # Edited since it was loaded: nothing can be stored.
        if (kept.content_hash, kept.name) == (robot.content_hash, robot.name):
            publish_folder(folder, target)


def _toml_text(path: Path, robot: Robot) -> str | None:
    """The robot.toml of a robot, with its serial number; None for none.

    A line is inserted into the user's text, so that comments are kept.
    """
    file = path / TOML if path.is_dir() else None
    text = file.read_text(encoding="utf-8") if file and file.is_file() else None
    used, written = json.loads(robot.toml), tomllib.loads(text or "")
    if set(used) - {"robot"} != set(written) - {"robot", "columns"}:
        # The chain is in the URDF already; declared values of an MJCF are only here.
        columns = {"columns": dict(robot.columns)} if robot.columns else {}
        return tomli_w.dumps(used | columns)
    if robot.serial is None or "serial" in tomllib.loads(text or "").get("robot", {}):
        return text
    line = f"serial = {json.dumps(robot.serial)}\n"
    table = re.search(r"^\[robot\][^\n]*\n", text or "", re.MULTILINE)
    if table:
        return text[: table.end()] + line + text[table.end() :]
    return f"[robot]\n{line}\n{text or ''}"


def find_robot_by_hash(store: Path, content_hash: str) -> str:
    """Return the word for the robot of a hash: a built-in name, or its stored folder."""
    for name in list_built_in_robots():
        if load_robot(name).content_hash == content_hash:
            return name
    folder = build_robot_path(store, content_hash)
    if fetch_record(folder):
        return str(folder)
    raise InputError(
        f"No description of the robot {content_hash[:8]} is in {format_store_name(store)}. "
        "Import a log of it again with --robot, which stores it."
    )


def find_used_robot(store: Path, reference: str, content_hash: str | None) -> str:
    """Return what to load a robot from, such that it is the one that was used."""
    try:
        if content_hash in (None, load_robot(reference).content_hash):
            return reference
        why = f"{reference} describes another robot now"
    except ModelgapError as error:
        why = str(error)
    kept = build_robot_path(store, content_hash or "")
    if fetch_record(kept) and _hash(str(kept)) == content_hash:
        return str(kept)
    raise InputError(
        f"The robot that this was made with is missing: {why} The store has no "
        "description of it either. Restore the URDF and robot.toml of that time."
    )


def build_robot_path(store: Path, content_hash: str) -> Path:
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
