"""How long a call takes: the model of an IRB140 with the tables of a calibration."""

from time import process_time

import numpy as np

from benchmarks.export_parts.models import model_with, robot_of, term
from benchmarks.figures import Figures, figure, missing
from flows.proofs.c import compiled, compiler
from flows.proofs.proof import loaded
from residual.export.c99 import to_c99
from residual.export.exported import exciting
from residual.export.numpy_file import to_numpy
from residual.model.corrected import NEAREST, Corrected, Tables
from residual.model.model import Model
from residual.tables.form import MAIN
from residual.tables.lookup import Axis, Lookup, Table

NUMPY_BAR, C_BAR = 5.0, 2.0  # microseconds a row
LEVELS, ROWS, TIMES = 22, 10_000, 7
SIGNALS = ("q", "qd", "qdd")


def speed_figures() -> Figures:
    """Time per row of body, friction and tables, NumPy alone and compiled."""
    whole, motion = _whole(), exciting(robot_of("irb140"), ROWS / 250)
    told = "rigid body, friction of all joints, 18 tables of 22 levels for each joint"
    out: Figures = {}
    with loaded(to_numpy(whole)) as torque:
        each, got = _each(lambda: torque(motion.t, *motion.parts))
    gap = np.abs(got - whole.along(motion.t, motion.parts)).max()
    out["numpy_microseconds"] = figure(each, NUMPY_BAR, ROWS, what=told)
    out["tables_numpy"] = figure(float(gap), 1e-9, ROWS)
    if compiler() is None:
        return out | {"c_microseconds": missing(C_BAR, "no C compiler here")}
    with compiled(to_c99(whole)) as along:
        each, got = _each(lambda: along(motion))
    gap = np.abs(got - whole.along(motion.t, motion.parts)).max()
    out["c_microseconds"] = figure(each, C_BAR, ROWS, what=told)
    return out | {"tables_c": figure(float(gap), 1e-9, ROWS)}


def _each(run) -> tuple[float, np.ndarray]:
    """Least time of a row [microseconds]: of the processor, whoever else uses it."""
    least, out = np.inf, run()
    for _ in range(TIMES):
        start = process_time()
        out = run()
        least = min(least, process_time() - start)
    return 1e6 * least / ROWS, out


def _whole() -> Corrected:
    """A model with one table per variable on each joint, as of a calibration."""
    robot, rng = robot_of("irb140"), np.random.default_rng(0)
    names = ("viscous", "coulomb", "rotor_inertia")
    terms = [term(robot, n, j) for n in names for j in range(robot.dof)]
    model = model_with(robot)
    model = Model(robot, model.inertial, tuple(terms), model.speed_floor)
    columns = tuple((on, (j,), "") for on in SIGNALS for j in range(robot.dof))
    axes = [
        Axis(k, np.sort(rng.uniform(-2, 2, LEVELS - 1))) for k in range(len(columns))
    ]
    own = [
        Tables(j, columns, _lookup(axes, rng), MAIN, NEAREST) for j in range(robot.dof)
    ]
    return Corrected(model, tuple(own))


def _lookup(axes: list[Axis], rng: np.random.Generator) -> Lookup:
    count = len(axes)
    return Lookup(
        tuple(f"x{k}" for k in range(count)),
        ("torque",),
        tuple(axes),
        tuple(Table((k,), rng.normal(size=(LEVELS, 1))) for k in range(count)),
        rng.normal(size=1),
        np.zeros((count, 1)),
        np.full(count, -2.0),
        np.full(count, 2.0),
    )
