"""Round trips of an export through what reads it: files, NumPy, Pinocchio, MuJoCo."""

import json
import runpy
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from time import perf_counter
from types import ModuleType

import numpy as np

from residual.errors import InputError
from residual.export.exported import Exported, Motion, body_of, exciting, random_states
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


def text_of(made: Exported) -> str:
    """Return the first file of an export as text."""
    return next(iter(made.files.values())).decode()


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


def prove_numpy(made: Exported) -> Proof:
    """Run the file along a motion; its time per row is a note."""
    motion = exciting(body_of(made.whole).robot)
    with exported_names(made) as names:
        torque = names["torque"]
        start = perf_counter()
        got = torque(motion.t, *motion.parts)
        each = (perf_counter() - start) / len(motion.t)
    want = made.carried.along(motion.t, motion.parts)
    note = f"{1e6 * each:.2g} microseconds a row"
    return compared("run with NumPy alone", got, want, (note,))


@contextmanager
def exported_names(made: Exported) -> Iterator[dict]:
    """Give the functions of the file by name, while they are needed."""
    with unpacked(made.files) as place:
        yield runpy.run_path(str(place / "torque.py"))


def prove_json(made: Exported) -> Proof:
    """Read the file and predict with it, along a motion."""
    again = from_record(json.loads(text_of(made)))
    motion = exciting(body_of(made.whole).robot)
    torques = [m.along(motion.t, motion.parts) for m in (again, made.carried)]
    return compared("read again and predicted", *torques)


def prove_urdf(made: Exported) -> Proof:
    """Let Pinocchio read inertias, damping and friction, and compute torque."""
    model = body_of(made.carried)
    read = build_model(text_of(made), "the URDF")
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


def prove_table(made: Exported) -> Proof:
    """Read the support points and go along lines between them."""
    model, gaps, sizes, points = body_of(made.carried), [0.0], [0.0], 0
    notes = ["between support points the torque is taken along straight lines"]
    for name in (name for name in (SPEED, POSITION) if name in made.files):
        text = made.files[name].decode().splitlines()
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


def prove_mjcf(made: Exported) -> Proof:
    """Compare MuJoCo's inverse dynamics on random states of full friction."""
    mujoco = extra("mujoco")
    model, text = body_of(made.carried), text_of(made)
    speed = saturated_speed(model)
    states = random_states(model.robot, STATES, speed)
    got = inverse(text, states)
    notes: tuple[str, ...] = ()
    if (np.array(mujoco_model(text).dof_frictionloss) > 0).any():
        notes = (_creeping(made, text, speed),)
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


def _creeping(made: Exported, text: str, speed: Array) -> str:
    """By how much the two differ where our dry friction is smooth."""
    model = body_of(made.carried)
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
