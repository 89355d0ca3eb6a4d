"""Runs back out of the store."""

from pathlib import Path

from residual.errors import InputError
from residual.recording import Recording
from warehouse.files import read_parquet, to_arrays
from warehouse.ids import data_hash
from warehouse.layout import SAMPLES_FILE, find_run
from warehouse.manifest import read_manifest

_OF_RECORDING = ("t", "q", "tau", "qd", "qdd", "q_ref")


def read_run(store: Path, run_id: str) -> Recording:
    """Return what was logged in a run, bit for bit as it was committed.

    Args:
        store: The store.
        run_id: Id of the run, or its beginning.

    Returns:
        The recording, its id that of the run.

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
    run = find_run(store, run_id)
    path = run.folder / SAMPLES_FILE
    arrays = to_arrays(read_parquet(path))
    if data_hash(arrays) != read_manifest(store, run.id)["data_hash"]:
        raise InputError(
            f"{path} is damaged: its values are not those that were committed. "
            "Take its folder out of the store."
        )
    return arrays
