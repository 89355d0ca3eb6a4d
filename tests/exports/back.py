"""Exports run in the program that each is for: its torque, beside what is carried."""

import ctypes
import json
import os
import runpy
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from residual.export.c99 import POSITION, SPEED, evaluate_table_curve, make_c_identifier
from residual.export.model_export import (
    RATE,
    ModelExport,
    NoiselessMotion,
    build_reference_motion,
    fill_joint_limits,
    remove_tables,
)
from residual.model.model import LEAST_SPEED, Model
from residual.model.model_files import model_from_record
from residual.recording import Array
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.files import build_pinocchio_model
from residual.robot.robot import Robot
from residual.signals.track import SMOOTH

STATES = 1000  # random ones, of one comparison
CREEP = 1e-3  # rad/s: dry friction must have its value from here on
FULL = 20.0  # tanh of it is one, to the last bit
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
# The torque of the target, and that of what the export carries [N m].
Pair = tuple[Array, Array]


def find_compiler() -> str | None:
    """Return the C compiler of this machine: $CC, else cc or gcc; None for none."""
    names = (os.environ.get("CC", ""), "cc", "gcc")
    return next((result for n in names if n and (result := shutil.which(n))), None)


needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


def compile_library(place: Path, source: str, name: str) -> None:
    """Compile a file of a folder into a shared library there."""
    flags = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-shared", "-fPIC")
    command = [find_compiler() or "cc", *flags, "-o", name, source, "-lm"]
    subprocess.run(command, cwd=place, check=True, capture_output=True)


def text_of(made: ModelExport) -> str:
    return next(iter(made.files.values())).decode()


@contextmanager
def unpacked(files: Mapping[str, bytes]) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            (Path(folder) / name).write_bytes(content)
        yield Path(folder)


def random_states(robot: Robot, count: int) -> NoiselessMotion:
    lower, upper, speed = fill_joint_limits(robot)
    rng, shape = np.random.default_rng(0), (count, robot.dof)
    qd = rng.uniform(0.0, speed, shape) * rng.choice([-1.0, 1.0], shape)
    q, qdd = rng.uniform(lower, upper, shape), rng.uniform(-10.0, 10.0, shape)
    return NoiselessMotion(np.arange(count) / RATE, q, qd, qdd)


def fast_states(model: Model, count: int = STATES) -> NoiselessMotion:
    """Return random states, each joint faster than where dry friction is full."""
    known = model.speed_floor
    floor = np.full(model.robot.dof, LEAST_SPEED) if known is None else known
    shapes = model.standstill or (SMOOTH,) * model.robot.dof
    times = [max(s.reach, FULL * s.size if s.kind == "smooth" else 0) for s in shapes]
    states, slow = random_states(model.robot, count), floor * np.array(times)
    return NoiselessMotion(states.t, states.q, states.qd + np.sign(states.qd) * slow, states.qdd)


def _along(made: ModelExport, got: Callable[[NoiselessMotion], Array]) -> Pair:
    motion = build_reference_motion(remove_tables(made.source).robot)
    return got(motion), made.carried.along(motion.t, motion.parts)


def json_back(made: ModelExport) -> Pair:
    again = model_from_record(json.loads(text_of(made)))
    return _along(made, lambda motion: again.along(motion.t, motion.parts))


def urdf_back(made: ModelExport) -> Pair:
    model = remove_tables(made.carried)
    read = build_pinocchio_model(text_of(made), "the URDF")
    # A URDF says nothing of gravity.
    read.gravity.linear = model.robot.model.gravity.linear
    states = fast_states(model)
    got = compute_inverse_dynamics(read, *states.parts)
    got += states.qd * read.damping + np.sign(states.qd) * read.upperDryFrictionLimit
    return got, model.torque(*states.parts)


def table_back(made: ModelExport) -> Pair:
    """Read the support points and go along lines between them."""
    model, got, want = remove_tables(made.carried), [np.zeros(1)], [np.zeros(1)]
    for name in (name for name in (SPEED, POSITION) if name in made.files):
        text = made.files[name].decode().splitlines()
        rows = np.loadtxt(text, delimiter=",", skiprows=1, ndmin=2)
        for j in range(model.robot.dof):
            _, x, y = rows[rows[:, 0] == j + 1].T
            if len(x):
                places = np.random.default_rng(j).uniform(x[0], x[-1], STATES)
                got.append(np.interp(places, x, y))
                want.append(evaluate_table_curve(model, name, j, places))
    return np.concatenate(got), np.concatenate(want)


def mjcf_back(made: ModelExport) -> Pair:
    """Compare MuJoCo's inverse dynamics on random states of full friction."""
    model = remove_tables(made.carried)
    states = fast_states(model)
    return inverse(text_of(made), states), model.torque(*states.parts)


def inverse(text: str, states: NoiselessMotion) -> Array:
    import mujoco

    return _inverse(mujoco.MjModel.from_xml_string(text), states)


def _inverse(model, motion: NoiselessMotion) -> Array:
    import mujoco

    data, out = mujoco.MjData(model), np.empty_like(motion.q)
    for i, t in enumerate(motion.t):
        data.time = t
        data.qpos[:], data.qvel[:], data.qacc[:] = (x[i] for x in motion.parts)
        mujoco.mj_inverse(model, data)
        out[i] = data.qfrc_inverse
    return out


def mujoco_back(made: ModelExport) -> Pair:
    """Let MuJoCo find the torque along a motion, with what the module beside adds."""
    with passive(made) as simulated:
        return _along(made, lambda motion: _inverse(simulated, motion))


@contextmanager
def passive(made: ModelExport, timestep: float | None = None) -> Iterator:
    """Give the compiled MJCF of an export, its callback set meanwhile."""
    import mujoco

    with unpacked(made.files) as place:
        (module,) = (n for n in made.files if n.endswith(".py"))
        beside = runpy.run_path(str(place / module))
        try:
            yield beside["load"](timestep)
        finally:
            mujoco.set_mjcb_passive(None)


def c99_back(made: ModelExport) -> Pair:
    with compiled(made) as along:
        return _along(made, along)


@contextmanager
def compiled(made: ModelExport) -> Iterator[Callable[[NoiselessMotion], Array]]:
    dof, ((name, text),) = remove_tables(made.source).robot.dof, made.files.items()
    p = make_c_identifier(name.removesuffix(".h"))
    around = AROUND.format(header=name, p=p, dof=dof).encode()
    with unpacked({name: text, "around.c": around}) as place:
        compile_library(place, "around.c", "around.so")
        library = ctypes.CDLL(str(place / "around.so"))

        def along(motion: NoiselessMotion) -> Array:
            arrays = [np.ascontiguousarray(x) for x in (motion.t, *motion.parts)]
            out = np.empty_like(motion.q)
            ends = [x.ctypes.data_as(ctypes.c_void_p) for x in (*arrays, out)]
            library.along(len(motion.t), *ends)
            return out

        yield along


def rrd_back(made: ModelExport) -> Pair:
    from rerun.chunk import RrdReader

    dof, sums = remove_tables(made.source).robot.dof, {}
    (content,) = made.files.values()
    with unpacked({"arm.rrd": content}) as place:
        for chunk in RrdReader(str(place / "arm.rrd")).stream().to_chunks():
            if chunk.entity_path.startswith("/torque/"):
                column = chunk.to_record_batch().column("Scalars:scalars")
                values = column.flatten().to_numpy(zero_copy_only=False)
                sums.setdefault(chunk.entity_path, []).append(values)
    source = {path: np.concatenate(parts) for path, parts in sums.items()}
    got, want = [], []
    for j in range(dof):
        under = f"/torque/joint_{j + 1}/"
        got.append(sum(v for k, v in source.items() if k.startswith(f"{under}of/")))
        want.append(source[f"{under}model"])
    return np.column_stack(got), np.column_stack(want)


BACK: Mapping[str, Callable[[ModelExport], Pair]] = {
    "json": json_back,
    "urdf": urdf_back,
    "mjcf": mjcf_back,
    "mujoco": mujoco_back,
    "c99": c99_back,
    "rrd": rrd_back,
    "table": table_back,
}
