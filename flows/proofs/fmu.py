"""An FMU, compiled here and played by FMPy."""

import tempfile
from pathlib import Path

import numpy as np

from flows.proofs.c import build, compiler
from flows.proofs.proof import Proof, compared, extra
from residual.export.exported import Exported, Motion, Whole, body_of, exciting
from residual.export.fmu import SOURCE, fmu_parts, to_fmu
from residual.recording import Array

SIGNALS = ("q", "qd", "qdd")


def make_fmu(whole: Whole) -> Exported:
    """Return a model as an FMU, with a library where there is a C compiler.

    Raises:
        RunError: If the compiler refuses it.
    """
    parts = fmu_parts(whole)
    if compiler() is None:
        return to_fmu(parts, None)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for name, text in parts.sources.items():
            (place / name).write_bytes(text)
        build(place, [SOURCE], "library.so", "-fvisibility=hidden")
        return to_fmu(parts, (place / "library.so").read_bytes())


def prove_fmu(made: Exported) -> Proof:
    """Let FMPy check the FMU and play it along a motion.

    Raises:
        InputError: If FMPy is not installed.
    """
    if compiler() is None:
        why = "no C compiler here (cc, gcc or $CC): the FMU has sources alone"
        return Proof(why, 0, None, 0.0)
    fmpy, motion = extra("fmpy"), exciting(body_of(made.whole).robot)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.fmu"
        (content,) = made.files.values()
        path.write_bytes(content)
        problems = extra("fmpy.validation").validate_fmu(str(path))
        got = played(path, motion)
    want = made.carried.along(motion.t, motion.parts)[: len(got)]
    by = f"played by FMPy {fmpy.__version__}"
    return compared(by, got, want, tuple(f"FMPy objects: {p}" for p in problems))


def played(path: Path, motion: Motion) -> Array:
    """Return the torque of every sample but the last one [N m]. Shape (n - 1, dof)."""
    dof = motion.q.shape[1]
    names = [f"{signal}{j + 1}" for signal in SIGNALS for j in range(dof)]
    columns = [motion.t, *np.hstack(motion.parts).T]
    kinds = [("time", float), *((name, float) for name in names)]
    rows = np.array(list(zip(*columns, strict=True)), dtype=kinds)
    done = extra("fmpy").simulate_fmu(
        str(path),
        start_time=float(motion.t[0]),
        stop_time=float(motion.t[-1]),
        step_size=float(motion.t[1] - motion.t[0]),
        output_interval=float(motion.t[1] - motion.t[0]),
        input=rows,
        output=[f"tau{j + 1}" for j in range(dof)],
    )
    # What a step computed stands at its end.
    return np.column_stack([done[f"tau{j + 1}"][1:] for j in range(dof)])
