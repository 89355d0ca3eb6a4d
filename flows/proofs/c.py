"""What is compiled here: a C99 header, an FMU in FMPy, a callback in MuJoCo."""

import ctypes
import os
import runpy
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import numpy as np

from flows.proofs.proof import Proof, compared, extra, unpacked
from residual.errors import RunError
from residual.export.c99 import prefix_of
from residual.export.exported import Exported, Motion, Whole, body_of, exciting
from residual.export.fmu import SOURCE, fmu_parts, to_fmu
from residual.recording import Array

SIGNALS = ("q", "qd", "qdd")  # inputs of an FMU
NONE_HERE = "no C compiler here (cc, gcc or $CC)"
KINDS = ("model exchange", "co-simulation")  # of an FMU
FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-shared", "-fPIC")
AROUND = """\
#include "{header}"
void along(int n, const double *t, const double *q, const double *qd,
           const double *qdd, double *tau)
{{
    {p}_memory memory;
    {p}_start(&memory);
    for (int i = 0; i < n; i++)
        {p}_torque(&memory, t[i], q + {dof} * i, qd + {dof} * i, qdd + {dof} * i,
                   tau + {dof} * i);
}}
"""


def compiler() -> str | None:
    """Return the C compiler of this machine: $CC, else cc or gcc; None for none."""
    names = (os.environ.get("CC", ""), "cc", "gcc")
    return next((found for n in names if n and (found := shutil.which(n))), None)


def prove_c99(made: Exported) -> Proof:
    """Compile the header and run it along a motion; its time per call is a note."""
    if compiler() is None:
        return Proof(NONE_HERE, 0, None, 0.0)
    motion = exciting(body_of(made.whole).robot)
    with compiled(made) as along:
        got = along(motion)
        start = perf_counter()
        along(motion)
        each = (perf_counter() - start) / len(motion.t)
    want = made.carried.along(motion.t, motion.parts)
    note = f"{1e6 * each:.2g} microseconds a call"
    return compared("compiled with the C compiler of this machine", got, want, (note,))


@contextmanager
def compiled(made: Exported) -> Iterator:
    """Give the compiled header as a function of a motion, while it is needed."""
    dof, (name, text) = body_of(made.whole).robot.dof, next(iter(made.files.items()))
    p = prefix_of(name.removesuffix(".h"))
    around = AROUND.format(header=name, p=p, dof=dof).encode()
    with unpacked({name: text, "around.c": around}) as place:
        build(place, ["around.c"], "around.so")
        library = ctypes.CDLL(str(place / "around.so"))

        def along(motion: Motion) -> Array:
            arrays = [np.ascontiguousarray(x) for x in (motion.t, *motion.parts)]
            out = np.empty_like(motion.q)
            ends = [x.ctypes.data_as(ctypes.c_void_p) for x in (*arrays, out)]
            library.along(len(motion.t), *ends)
            return out

        yield along


def build(place: Path, sources: list[str], name: str, *flags: str) -> None:
    """Compile files of a folder into a shared library there."""
    command = [compiler() or "cc", *FLAGS, *flags, "-o", name, *sources, "-lm"]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True)
    if done.returncode:
        reason = next((x for x in done.stderr.splitlines() if "error" in x), "")
        raise RunError(f"The C compiler refuses the export: {reason[:160]}")


def make_fmu(whole: Whole) -> Exported:
    """Return a model as an FMU, with a library where there is a C compiler."""
    parts = fmu_parts(whole)
    if compiler() is None:
        return to_fmu(parts, None)
    with unpacked(parts.sources) as place:
        build(place, [SOURCE], "library.so", "-fvisibility=hidden")
        return to_fmu(parts, (place / "library.so").read_bytes())


def prove_fmu(made: Exported) -> Proof:
    """Let FMPy check the FMU and play it along a motion."""
    if compiler() is None:
        return Proof(f"{NONE_HERE}: the FMU has sources alone", 0, None, 0.0)
    fmpy, motion = extra("fmpy"), exciting(body_of(made.whole).robot)
    (content,) = made.files.values()
    with unpacked({"model.fmu": content}) as place:
        path = place / "model.fmu"
        problems = extra("fmpy.validation").validate_fmu(str(path))
        ways = [played(path, motion, kind) for kind in KINDS]
    want = made.carried.along(motion.t, motion.parts)
    by = f"played by FMPy {fmpy.__version__}, as {' and as '.join(KINDS)}"
    notes = tuple(f"FMPy objects: {p}" for p in problems)
    return compared(by, np.hstack(ways), np.hstack([want] * len(ways)), notes)


def played(path: Path, motion: Motion, kind: str) -> Array:
    """Return the torque of every sample, at its own time [N m]. Shape (n, dof).

    Args:
        kind: One of `KINDS`. For model exchange FMPy has a loop; of its loop for
            co-simulation the recorder reads before the inputs are set, so that here
            they are set, and the torque read, from the outside.
    """
    if kind == KINDS[1]:
        return _stepped(path, motion)
    dof = motion.q.shape[1]
    names = [f"{signal}{j + 1}" for signal in SIGNALS for j in range(dof)]
    columns = [motion.t, *np.hstack(motion.parts).T]
    kinds = [("time", float), *((name, float) for name in names)]
    rows = np.array(list(zip(*columns, strict=True)), dtype=kinds)
    step = float(motion.t[1] - motion.t[0])
    done = extra("fmpy").simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        solver="Euler",
        start_time=float(motion.t[0]),
        stop_time=float(motion.t[-1]),
        step_size=step,
        output_interval=step,
        input=rows,
        output=[f"tau{j + 1}" for j in range(dof)],
    )
    return np.column_stack([done[f"tau{j + 1}"] for j in range(dof)])


def _stepped(path: Path, motion: Motion) -> Array:
    """Go step by step: set the inputs of a time, read its torque, go on."""
    fmpy, dof = extra("fmpy"), motion.q.shape[1]
    about = fmpy.read_model_description(str(path))
    folder = fmpy.extract(str(path))
    own = extra("fmpy.fmi2").FMU2Slave(
        guid=about.guid,
        unzipDirectory=folder,
        modelIdentifier=about.coSimulation.modelIdentifier,
        instanceName="model",
    )
    inputs, outputs = list(range(3 * dof)), list(range(3 * dof, 4 * dof))
    rows, out = np.hstack(motion.parts), np.empty_like(motion.q)
    own.instantiate()
    own.setupExperiment(startTime=float(motion.t[0]))
    own.enterInitializationMode()
    own.exitInitializationMode()
    for k, (now, row) in enumerate(zip(motion.t, rows, strict=True)):
        own.setReal(inputs, row)
        out[k] = own.getReal(outputs)
        own.doStep(float(now), float(motion.t[1] - motion.t[0]))
    own.terminate()
    own.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)
    return out


def prove_mujoco(made: Exported) -> Proof:
    """Let MuJoCo find the torque along a motion, with what the module beside adds."""
    mujoco, model = extra("mujoco"), body_of(made.carried)
    if compiler() is None:
        return Proof(NONE_HERE, 0, None, 0.0)
    motion = exciting(model.robot)
    got = np.empty_like(motion.q)
    with passive(made) as simulated:
        data = mujoco.MjData(simulated)
        for k in range(len(got)):
            data.time = motion.t[k]
            data.qpos[:], data.qvel[:], data.qacc[:] = (x[k] for x in motion.parts)
            mujoco.mj_inverse(simulated, data)
            got[k] = data.qfrc_inverse
    want = made.carried.along(motion.t, motion.parts)
    note = f"time step {simulated.opt.timestep:.3g} s"
    by = f"inverse dynamics of MuJoCo {mujoco.__version__}, with the callback"
    return compared(by, got, want, (note,))


@contextmanager
def passive(made: Exported, timestep: float | None = None) -> Iterator:
    """Give the compiled MJCF of an export, its callback set meanwhile."""
    with unpacked(made.files) as place:
        (module,) = (n for n in made.files if n.endswith(".py"))
        beside = runpy.run_path(str(place / module))
        try:
            yield beside["load"](timestep)
        finally:
            extra("mujoco").set_mjcb_passive(None)
