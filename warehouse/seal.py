"""The hidden half of a simulated run: hashed before, opened only afterwards.

A diagnosis must not be able to look at what was planted. The hash in the run's
manifest shows later that the truth was not changed to fit the verdict.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from residual.errors import InputError
from warehouse.files import publish, read_parquet, staged, to_arrays, to_table
from warehouse.files import write_parquet as write
from warehouse.ids import canonical, check_id, data_hash, digest
from warehouse.kinds import SEALED
from warehouse.layout import find_run
from warehouse.objects.mirror import is_copied, is_there, shown
from warehouse.runs import read_manifest
from warehouse.schema import SIGNALS
from warehouse.sums import check_file

Array = np.ndarray

SPEC, TRUTH = "spec.json", "truth.parquet"


@dataclass(frozen=True, eq=False, slots=True)
class Sealed:
    """What a simulated run hides.

    Attributes:
        spec: The hidden half of the spec: effects, scatter, noise, salt.
        truth: Channels that no robot logs. Shapes (n,) or (n, k).
    """

    spec: Mapping
    truth: Mapping[str, Array] = field(default_factory=dict)


def sealed_hash(spec: object) -> str:
    """Return the hash of a hidden half; its salt keeps it from being guessed."""
    return digest(spec)


def commit_seal(store: Path, run_id: str, sealed: Sealed) -> None:
    """Put a hidden half into the store; one that is there already stays."""
    target = _folder(store, run_id)
    if is_copied(target):
        return
    units = {name: SIGNALS[name].unit for name in sealed.truth if name in SIGNALS}
    with staged(store, f"sealed-{run_id}") as folder:
        (folder / SPEC).write_bytes(canonical(sealed.spec))
        write(folder / TRUTH, to_table(sealed.truth, units))
        publish(folder, target)


def has_seal(store: Path, run_id: str) -> bool:
    """Return whether the hidden half of a run is in the store."""
    return is_there(_folder(store, run_id))


def open_seal(store: Path, run_id: str) -> Sealed:
    """Open the hidden half of a run: for reruns and for judging verdicts, only.

    Raises:
        InputError: If the run has no seal, or the seal is not the one that was hashed.
    """
    run = find_run(store, run_id)
    folder = _folder(store, run.id)
    check_file(folder / SPEC)
    try:
        spec = json.loads((folder / SPEC).read_bytes())
    except FileNotFoundError as error:
        raise InputError(
            f"Run {run.id} has no sealed half in {shown(store)}."
        ) from error
    except ValueError as error:
        raise InputError(f"{folder / SPEC} is damaged: it is no JSON.") from error
    manifest = read_manifest(store, run.id)
    truth = to_arrays(read_parquet(folder / TRUTH))
    hashed = manifest["sealed_sha256"], manifest["truth_hash"]
    if (sealed_hash(spec), data_hash(truth)) != hashed:
        raise InputError(
            f"The seal of run {run.id} is broken: {folder} is not the seal that was "
            "hashed when the run was made."
        )
    return Sealed(spec, truth)


def _folder(store: Path, run_id: str) -> Path:
    return store / SEALED / f"run_id={check_id(run_id)}"
