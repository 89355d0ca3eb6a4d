"""Round trips of an export through what reads it: files, NumPy, Pinocchio, MuJoCo."""

import ctypes
import json
import os
import runpy
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from time import perf_counter
from types import ModuleType

import numpy as np

from residual.errors import InputError, RunError
from residual.export.c99 import prefix_of
from residual.export.exported import (
    Exported,
    Motion,
    Whole,
    body_of,
    exciting,
    random_states,
)
from residual.export.fmu import SOURCE, fmu_parts, to_fmu
from residual.export.simulators import saturated_speed
from residual.export.table import POSITION, SPEED, curve_at
from residual.model.record import from_record
from residual.recording import Array
from residual.robot.dynamics import inverse_dynamics
from residual.robot.files import build_model

STATES = 1000  # random ones, of one comparison
CREEP = 1e-3  # rad/s: dry friction must have its value from here on


@dataclass(frozen=True, slots=True)
class Proof:
    """Torque of the exported model as its target computes it, against ours."""

    by: str  # what computed it
    states: int  # on how many states
    # Largest difference from what the export carries [N m]; None where it could not be
    # tried.
    difference: float | None
    torque: float  # largest torque among them [N m]
    notes: tuple[str, ...] = ()  # what else is to be known, a line each

    def __str__(self) -> str:
        if self.difference is None:
            return f"round trip: not tried; {self.by}"
        return (
            f"round trip: {self.by} on {self.states} states: largest difference from "
            f"what is carried {self.difference:.2g} N m, of {self.torque:.3g} N m"
        )


Prove = Callable[[Exported], Proof]


def compared(by: str, got: Array, want: Array, notes: tuple[str, ...] = ()) -> Proof:
    """Return the proof of two torques.

    Args:
        got: Torque of the target [N m]. Shape (n, dof).
        want: Torque of what the export carries [N m]. Shape (n, dof).
    """
    gap, size = np.abs(got - want).max(), np.abs(want).max()
    return Proof(by, len(want), float(gap), float(size), notes)


def text_of(exported: Exported) -> str:
    """Return the first file of an export as text."""
    return next(iter(exported.files.values())).decode()


def extra(package: str) -> ModuleType:
    """Return a package of the extra, which is loaded only when it is needed."""
    try:
        return import_module(package)
    except ImportError as error:
        raise InputError(
            f"This target needs {error.name}, which is not installed. Install the "
            "extra: pip install '.[export]' in the checkout."
        ) from error


@contextmanager
def unpacked(files: Mapping[str, bytes]) -> Iterator[Path]:
    """Give a folder with some files, while it is needed."""
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            (Path(folder) / name).write_bytes(content)
        yield Path(folder)


def prove_numpy(exported: Exported) -> Proof:
    """Run the file along a motion; its time per row is a note."""
    motion = exciting(body_of(exported.whole).robot)
    with exported_names(exported) as names:
        torque = names["torque"]
        start = perf_counter()
        got = torque(motion.t, *motion.parts)
        each = (perf_counter() - start) / len(motion.t)
    want = exported.carried.along(motion.t, motion.parts)
    note = f"{1e6 * each:.2g} microseconds a row"
    return compared("run with NumPy alone", got, want, (note,))


@contextmanager
def exported_names(exported: Exported) -> Iterator[dict]:
    """Give the functions of the file by name, while they are needed."""
    with unpacked(exported.files) as place:
        yield runpy.run_path(str(place / "torque.py"))


def prove_json(exported: Exported) -> Proof:
    """Read the file and predict with it, along a motion."""
    again = from_record(json.loads(text_of(exported)))
    motion = exciting(body_of(exported.whole).robot)
    torques = [m.along(motion.t, motion.parts) for m in (again, exported.carried)]
    return compared("read again and predicted", *torques)


def prove_urdf(exported: Exported) -> Proof:
    """Let Pinocchio read inertias, damping and friction, and compute torque."""
    model = body_of(exported.carried)
    read = build_model(text_of(exported), "the URDF")
    # A URDF says nothing of gravity.
    read.gravity.linear = model.robot.model.gravity.linear
    speed = saturated_speed(model)
    states = random_states(model.robot, STATES, speed)
    got = inverse_dynamics(read, *states.parts)
    got += states.qd * read.damping + np.sign(states.qd) * read.upperDryFrictionLimit
    notes = ["gravity is not in a URDF: set it where the URDF is used"]
    if (read.upperDryFrictionLimit > 0).any():
        notes.append(
            f"compared above {_listed(speed)} rad/s: below, dry friction here is "
            "smooth and there it jumps"
        )
    return compared("Pinocchio", got, model.torque(*states.parts), tuple(notes))


def prove_table(exported: Exported) -> Proof:
    """Read the support points and go along lines between them."""
    model, gaps, sizes, points = body_of(exported.carried), [0.0], [0.0], 0
    notes = ["between support points the torque is taken along straight lines"]
    for name in (name for name in (SPEED, POSITION) if name in exported.files):
        text = exported.files[name].decode().splitlines()
        rows = np.loadtxt(text, delimiter=",", skiprows=1, ndmin=2)
        for j in range(model.robot.dof):
            _, x, y = rows[rows[:, 0] == j + 1].T
            if not len(x):
                continue
            places = np.random.default_rng(j).uniform(x[0], x[-1], STATES)
            want = curve_at(model, name, j, places)
            gap = float(np.abs(np.interp(places, x, y) - want).max())
            gaps, sizes = [*gaps, gap], [*sizes, float(np.abs(want).max())]
            points += len(places)
            notes.append(f"{name}, joint {j + 1}: {len(x)} points, {gap:.2g} N m off")
    by = "read back and taken between its support points"
    return Proof(by, points, max(gaps), max(sizes), tuple(notes))


def prove_mjcf(exported: Exported) -> Proof:
    """Compare MuJoCo's inverse dynamics on random states of full friction."""
    mujoco = extra("mujoco")
    model, text = body_of(exported.carried), text_of(exported)
    speed = saturated_speed(model)
    states = random_states(model.robot, STATES, speed)
    got = inverse(text, states)
    notes: tuple[str, ...] = ()
    if (np.array(mujoco_model(text).dof_frictionloss) > 0).any():
        notes = (_creeping(exported, text, speed),)
    by = f"inverse dynamics of MuJoCo {mujoco.__version__}"
    return compared(by, got, model.torque(*states.parts), notes)


def mujoco_model(text: str):
    """Return the compiled model of an MJCF text."""
    return extra("mujoco").MjModel.from_xml_string(text)


def inverse(text: str, states: Motion) -> Array:
    """Return the torque that MuJoCo finds for given states [N m]. Shape (n, dof)."""
    mujoco, model = extra("mujoco"), mujoco_model(text)
    data, out = mujoco.MjData(model), np.empty_like(states.q)
    for i in range(len(out)):
        data.qpos[:], data.qvel[:], data.qacc[:] = (x[i] for x in states.parts)
        mujoco.mj_inverse(model, data)
        out[i] = data.qfrc_inverse
    return out


def _creeping(exported: Exported, text: str, speed: Array) -> str:
    """By how much the two differ where our dry friction is smooth."""
    model = body_of(exported.carried)
    fast = random_states(model.robot, STATES, speed)
    rng = np.random.default_rng(1)  # the same states at every call
    qd = rng.uniform(-1, 1, fast.qd.shape) * speed
    slow = Motion(fast.t, fast.q, qd, 0 * fast.qdd)
    gap = np.abs(inverse(text, slow) - model.torque(*slow.parts)).max()
    return (
        f"below {_listed(speed)} rad/s dry friction is smooth here and jumps there: "
        f"up to {gap:.3g} N m apart while the joints creep"
    )


def _listed(values: Array) -> str:
    return ", ".join(f"{v:.3g}" for v in values)


# What is compiled here: a C99 header, an FMU in FMPy, a callback in MuJoCo.


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


def prove_c99(exported: Exported) -> Proof:
    """Compile the header and run it along a motion; its time per call is a note."""
    if compiler() is None:
        return Proof(NONE_HERE, 0, None, 0.0)
    motion = exciting(body_of(exported.whole).robot)
    with compiled(exported) as along:
        got = along(motion)
        start = perf_counter()
        along(motion)
        each = (perf_counter() - start) / len(motion.t)
    want = exported.carried.along(motion.t, motion.parts)
    note = f"{1e6 * each:.2g} microseconds a call"
    return compared("compiled with the C compiler of this machine", got, want, (note,))


@contextmanager
def compiled(exported: Exported) -> Iterator:
    """Give the compiled header as a function of a motion, while it is needed."""
    dof, (name, text) = (
        body_of(exported.whole).robot.dof,
        next(iter(exported.files.items())),
    )
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


def prove_fmu(exported: Exported) -> Proof:
    """Let FMPy check the FMU and play it along a motion."""
    if compiler() is None:
        return Proof(f"{NONE_HERE}: the FMU has sources alone", 0, None, 0.0)
    fmpy, motion = extra("fmpy"), exciting(body_of(exported.whole).robot)
    (content,) = exported.files.values()
    with unpacked({"model.fmu": content}) as place:
        path = place / "model.fmu"
        problems = extra("fmpy.validation").validate_fmu(str(path))
        ways = [played(path, motion, kind) for kind in KINDS]
    want = exported.carried.along(motion.t, motion.parts)
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


def prove_mujoco(exported: Exported) -> Proof:
    """Let MuJoCo find the torque along a motion, with what the module beside adds."""
    mujoco, model = extra("mujoco"), body_of(exported.carried)
    if compiler() is None:
        return Proof(NONE_HERE, 0, None, 0.0)
    motion = exciting(model.robot)
    got = np.empty_like(motion.q)
    with passive(exported) as simulated:
        data = mujoco.MjData(simulated)
        for k in range(len(got)):
            data.time = motion.t[k]
            data.qpos[:], data.qvel[:], data.qacc[:] = (x[k] for x in motion.parts)
            mujoco.mj_inverse(simulated, data)
            got[k] = data.qfrc_inverse
    want = exported.carried.along(motion.t, motion.parts)
    note = f"time step {simulated.opt.timestep:.3g} s"
    by = f"inverse dynamics of MuJoCo {mujoco.__version__}, with the callback"
    return compared(by, got, want, (note,))


@contextmanager
def passive(exported: Exported, timestep: float | None = None) -> Iterator:
    """Give the compiled MJCF of an export, its callback set meanwhile."""
    with unpacked(exported.files) as place:
        (module,) = (n for n in exported.files if n.endswith(".py"))
        beside = runpy.run_path(str(place / module))
        try:
            yield beside["load"](timestep)
        finally:
            extra("mujoco").set_mjcb_passive(None)
