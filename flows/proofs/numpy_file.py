"""A torque.py, run by itself."""

import runpy
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

from flows.proofs.proof import Proof, compared
from residual.export.exported import Exported, body_of, exciting


def prove_numpy(made: Exported) -> Proof:
    """Run the file along a motion; its time per row is a note."""
    motion = exciting(body_of(made.whole).robot)
    with loaded(made) as torque:
        start = perf_counter()
        got = torque(motion.t, *motion.parts)
        each = (perf_counter() - start) / len(motion.t)
    want = made.carried.along(motion.t, motion.parts)
    note = f"{1e6 * each:.2g} microseconds a row"
    return compared("run with NumPy alone", got, want, (note,))


@contextmanager
def loaded(made: Exported) -> Iterator:
    """Give the function `torque` of the file, while it is needed."""
    with tempfile.TemporaryDirectory() as folder:
        for name, content in made.files.items():
            (Path(folder) / name).write_bytes(content)
        yield runpy.run_path(str(Path(folder) / "torque.py"))["torque"]
