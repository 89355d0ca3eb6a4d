"""The motion behind a model, thin enough to go with it: what is compared with later.

Runs may be pruned, or stay in the store of another site. What a comparison of two
epochs reads of them is motion and torque below the filters' cut-off, and that is kept
with the model (METHOD section 13: a model without runs carries its states).
"""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
import pyarrow as pa

from residual.recording import Recording
from residual.signals.pieces import sketch_of
from residual.signals.track import Filters, thinned
from warehouse.files import read_parquet
from warehouse.layout import find

STATES = "states"  # the table, and its file in the folder of a model


def states_table(recordings: Sequence[Recording]) -> pa.Table | None:
    """Return filtered decimated motion and torque of logs; None of no logs.

    Args:
        recordings: The logs that a model is from; of long ones evenly spread pieces
            are kept, 420 s in all.

    Returns:
        A row per sample: ``log`` and ``robot``, ``t`` [s], ``q`` [rad] and ``tau``
        [N m], these two as lists of single precision.
    """
    logs = [thinned(own, Filters()) for own in sketch_of(recordings)]
    if not logs:
        return None
    count = [len(own.t) for own in logs]

    def words(values: list[str]) -> pa.Array:
        return pa.array(np.repeat(values, count).tolist()).dictionary_encode()

    def lists(parts: list[np.ndarray]) -> pa.Array:
        flat = np.concatenate(parts).astype(np.float32)
        return pa.FixedSizeListArray.from_arrays(flat.ravel(), flat.shape[1])

    columns = {
        # Pieces of one log have its name, so that each has a number beside it.
        "log": words([f"{i}/{own.id}" for i, own in enumerate(logs)]),
        "robot": words([own.robot for own in logs]),
        "t": np.concatenate([own.t for own in logs]),
        "q": lists([own.q for own in logs]),
        "tau": lists([own.tau for own in logs]),
    }
    return pa.table(columns)


def read_states(store: Path, diagnosis_model: str) -> tuple[Recording, ...]:
    """Return the motion that goes with a model; none where it has none.

    Raises:
        InputError: If there is no such model, or its motion is damaged.
    """
    path = find(store, diagnosis_model).folder / f"{STATES}.parquet"
    if not path.exists():
        return ()
    table = read_parquet(path)
    names = table.column("log").to_pylist()
    robot, t = table.column("robot")[0].as_py(), table.column("t").to_numpy()
    q, tau = (
        np.stack(table.column(name).to_numpy(zero_copy_only=False)).astype(float)
        for name in ("q", "tau")
    )
    out, first = [], 0
    for name, rows in groupby(names):
        own = slice(first, first := first + len(list(rows)))
        id = name.partition("/")[2]
        out.append(Recording(id, robot, t[own], q[own], tau[own]))
    return tuple(out)
