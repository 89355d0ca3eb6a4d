"""A torque.py, run by itself."""

import runpy
import tempfile
from pathlib import Path
from time import perf_counter

from flows.proofs.proof import Proof, compared
from residual.export.exported import Exported, body_of
from residual.export.motion import Motion, exciting
from residual.recording import Array


def prove_numpy(made: Exported) -> Proof:
    """Run the file along a motion; its time per row is a note.

    Args:
        made: The export.
    """
    motion = exciting(body_of(made.whole).robot)
    start = perf_counter()
    got = run(made, motion)
    each = (perf_counter() - start) / len(motion.t)
    want = made.carried.along(motion.t, motion.parts)
    note = f"{1e6 * each:.2g} microseconds a row, loading it included"
    return compared("run with NumPy alone", got, want, (note,))


def run(made: Exported, motion: Motion) -> Array:
    """Return the torque that the file computes [N m]. Shape (n, dof)."""
    with tempfile.TemporaryDirectory() as folder:
        for name, content in made.files.items():
            (Path(folder) / name).write_bytes(content)
        torque = runpy.run_path(str(Path(folder) / "torque.py"))["torque"]
        return torque(motion.t, *motion.parts)
