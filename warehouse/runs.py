"""Runs back out of the store: their samples, their manifest, their tombstones.

Keys that a caller gives: ``spec`` (the open half: robot, trajectory, declared effects,
rates, reference seed), ``source``, ``kind``, ``trajectory``, ``seed``, ``robot_hash``,
``seed_streams``, ``timings``, ``parents``; of a measured run ``serial``,
``recorded_at`` (of its first sample, ISO 8601, UTC) and ``tags`` (texts), where they
are known; others are kept as they are. The commit adds
``sealed_sha256``, ``provenance``, ``data_hash``, ``truth_hash`` and ``units``.
"""

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from residual.errors import InputError
from residual.recording import Recording
from warehouse.files import read_parquet, replace_file, to_arrays
from warehouse.ids import ID_DIGITS, check_id, data_hash
from warehouse.kinds import KINDS, QUARANTINE, SAMPLES_FILE
from warehouse.layout import find_run
from warehouse.objects.mirror import at_hand, names_in

Parents = Sequence[str | tuple[str, str]] | Mapping[str, Sequence[str]]


def read_manifest(store: Path, run_id: str) -> dict:
    """Return the manifest of a run.

    Raises:
        InputError: If there is no such run, or it is damaged.
    """
    return _manifest(find_run(store, run_id).folder)


def _manifest(folder: Path) -> dict:
    row = read_parquet(folder / KINDS["runs"].row, ["manifest"])
    return json.loads(row.column("manifest")[0].as_py())


def lineage_rows(parents: Parents, role: str = "input") -> list[dict]:
    """Return parents as rows of the view ``lineage``, without the child.

    Args:
        parents: Ids, pairs of id and role, or lists of ids by role.

    Raises:
        InputError: If an id is none.
    """
    if isinstance(parents, Mapping):
        pairs = [(id, name) for name, ids in parents.items() for id in ids]
    else:
        pairs = [(p, role) if isinstance(p, str) else tuple(p) for p in parents]
    rows = [{"parent": check_id(id), "role": str(name)} for id, name in pairs]
    if len({tuple(row.values()) for row in rows}) < len(rows):
        raise InputError("A parent is given twice in one role, expected it once.")
    return rows


def about_run(manifest: Mapping) -> dict:
    """Return the columns of ``runs`` that the manifest decides."""
    spec = manifest.get("spec") or {}
    motion = spec.get("trajectory") or {}
    motion = motion.get("kind") if isinstance(motion, Mapping) else motion
    simulated = "spec" in manifest
    recorded = manifest.get("recorded_at")
    return {
        "serial": manifest.get("serial"),
        "recorded_at": recorded and parse_moment(recorded),
        "tags": list(manifest.get("tags") or ()),
        "source": manifest.get("source", "simulated" if simulated else "imported"),
        "kind": manifest.get("kind", "experiment" if simulated else "log"),
        "trajectory": manifest.get("trajectory", motion),
        "seed": manifest.get("seed", spec.get("seed")),
        **about_origin(manifest),
    }


def about_origin(manifest: Mapping) -> dict:
    """Return the columns of ``runs`` that say what code made it, where, for what."""
    made = manifest.get("provenance") or {}
    return {
        "commit": made.get("commit"),
        "version": (made.get("versions") or {}).get("modelgap"),
        "machine": made.get("machine"),
        "campaign": manifest.get("campaign"),
    }


def parse_moment(text: str) -> datetime:
    """Return the moment of a record, UTC without saying so, as columns hold it.

    Raises:
        InputError: If it is none.
    """
    try:
        moment = datetime.fromisoformat(text)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"'{text}' is no moment in ISO 8601, such as 2026-11-22T10:30:00Z."
        ) from error
    return moment.astimezone(UTC).replace(tzinfo=None)


_OF_RECORDING = ("t", "q", "tau", "qd", "qdd", "q_ref")


def read_run(store: Path, run_id: str) -> Recording:
    """Return what was logged in a run, bit for bit as it was committed.

    Raises:
        InputError: If there is no such run, or its samples are damaged.
    """
    run = find_run(store, run_id)
    channels = read_channels(store, run.id)
    robot = run.folder.parent.name.removeprefix("robot=")
    logged = {name: channels[name] for name in _OF_RECORDING if name in channels}
    return Recording(id=run.id, robot=robot, **logged)


def read_channels(store: Path, run_id: str) -> dict:
    """Return all channels of a run by name, the errors of the twin among them.

    Raises:
        InputError: If there is no such run, or its samples are damaged.
    """
    return check_samples(find_run(store, run_id).folder)


def check_samples(folder: Path) -> dict:
    """Return the channels in the folder of a run, held against the hash of its record.

    Raises:
        InputError: If they are damaged.
    """
    path = folder / SAMPLES_FILE
    arrays = to_arrays(read_parquet(path))
    if data_hash(arrays) != _manifest(folder)["data_hash"]:
        raise InputError(
            f"{path} is damaged: its values are not those that were committed. "
            "Take its folder out of the store."
        )
    return arrays


def quarantine(store: Path, run_id: str, reason: str) -> Path:
    """Say that a run should not be used; nothing of it is deleted or changed.

    Returns:
        The tombstone; the first one stays.

    Raises:
        InputError: If there is no such run, or no reason.
    """
    if not reason.strip():
        raise InputError("A quarantine needs a reason, for those who find it later.")
    id = find_run(store, run_id).id
    target = store / QUARANTINE / f"run_id={id}.json"
    at_hand(target)
    if not target.exists():
        told = {"run_id": id, "reason": reason, "at": datetime.now(UTC).isoformat()}
        replace_file(store, target, (json.dumps(told) + "\n").encode())
    return target


def quarantined(store: Path) -> frozenset[str]:
    """Return the ids of all runs with a tombstone."""
    names = names_in(store, QUARANTINE)
    names = (n[:-5] for n in names if n.startswith("run_id=") and n.endswith(".json"))
    ids = (name.removeprefix("run_id=") for name in names)
    return frozenset(check_id(id) for id in ids if len(id) == ID_DIGITS)


def tombstone(store: Path, run_id: str) -> str | None:
    """Return why a run should not be used, None where it may be."""
    path = store / QUARANTINE / f"run_id={check_id(run_id)}.json"
    at_hand(path)
    try:
        return str(json.loads(path.read_bytes()).get("reason"))
    except FileNotFoundError:
        return None
    except (ValueError, AttributeError):
        return "its tombstone cannot be read"
