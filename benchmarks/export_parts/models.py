"""Models with one effect each, through each target and back, on two arms.

Beside them the time of a call: the model of an IRB140 with the tables of a calibration.
"""

import io
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from benchmarks.export_parts.back import BACK, compiled
from benchmarks.harness.figures import Figures, figure, missing, partial
from benchmarks.harness.rates import cpu
from flows.steps.export import TARGETS, compiler
from residual.effects import registry
from residual.export.c99 import to_c99
from residual.export.exported import Exported, Motion, exciting
from residual.model.corrected import NEAREST, Corrected, Tables
from residual.model.model import Model, Term
from residual.robot.dynamics import inertial_parameters
from residual.robot.robot import Robot, load_robot, robot_from_texts
from residual.tables.evaluate import by_row, predict
from residual.tables.form import MAIN
from residual.tables.lookup import Axis, Lookup, Table, export_lookup

LENGTH = 0.35  # m
NAMES = sorted(registry())
ARMS = ("irb140", "seven")
DRIVES = ("viscous", "coulomb", "rotor_inertia")
# Coefficients, and numbers of the shape, that an arm may have: sizes, not units.
SIZES = {
    "backlash": ([1e-3], (1e-3,)),
    "balancer": ([6.0, 4.0], ()),
    "base_tilt": ([0.02, -0.01], ()),
    "coulomb": ([5.0], ()),
    "coulomb_asymmetry": ([1.0], ()),
    "coupled_friction": ([1.0, 0.3, 0.02], (-1.0, 0.05)),
    "delay": ([0.01], (0.012,)),
    "elasticity": ([1e-5], ()),
    "encoder_eccentricity": ([0.01, 0.02], ()),
    "encoder_offset": ([0.02], ()),
    "link_body": ([2.0, 0.2, 0.1, 0.0, 0.05, 0.0, 0.05, 0.0, 0.0, 0.05], ()),
    "link_inertia": ([0.2], ()),
    "load_friction": ([0.05], ()),
    "offset": ([2.0], ()),
    "position_friction": ([1.0, 0.7], ()),
    "power_viscous": ([2.0], (0.5,)),
    "presliding": ([3.0], (0.01,)),
    "quadratic_viscous": ([1.5], ()),
    "ripple": ([0.8, 0.5], (12.0,)),
    "rotor_inertia": ([0.6], ()),
    "saturation": ([1.0], (10.0,)),
    "spring": ([20.0, 3.0], ()),
    "stribeck": ([3.0], (0.1, 1.5)),
    "tool_force": ([5.0, -8.0, 12.0], ()),
    "torque_gain": ([0.05], ()),
    "viscous": ([4.0], ()),
    "viscous_asymmetry": ([0.5], ()),
    "warmup": ([2.0], (30.0,)),
}
BODY = (2.0, 0.02, -0.01, 0.08, 0.01, 0.001, 0.002, 0.012, 0.001, 0.009)


@cache
def robot_of(name: str) -> Robot:
    """The built-in arm, or one of seven joints whose links are bodies that can be."""
    if name != "seven":
        return replace(load_robot("irb140"), declared={})
    return robot_from_texts("seven", seven_joints(), "{}")


def seven_joints() -> str:
    """URDF of an arm of slender links, its axes alternating, its flange askew."""
    parts = ['<robot name="seven"><link name="l0"/>']
    for i in range(1, 8):
        mass, axis = 6.0 / i, "0 0 1" if i % 2 else "0 1 0"
        across = mass * LENGTH**2 / 12
        parts.append(
            f"""<link name="l{i}"><inertial>
            <origin xyz="{LENGTH / 2} 0.01 0.02"/><mass value="{mass}"/>
            <inertia ixx="0.008" iyy="{across}" izz="{across}" ixy="0" ixz="0" iyz="0"/>
            </inertial></link>
            <joint name="j{i}" type="revolute">
            <parent link="l{i - 1}"/><child link="l{i}"/>
            <origin xyz="{LENGTH if i > 1 else 0} 0 0" rpy="0 0 {0.1 * i}"/>
            <axis xyz="{axis}"/>
            <limit lower="-2.5" upper="2.5" velocity="3" effort="200"/></joint>"""
        )
    flange = """<link name="flange"/><joint name="to_flange" type="fixed">
        <parent link="l7"/><child link="flange"/>
        <origin xyz="0.3 0.02 0.1" rpy="0.4 0.8 -0.3"/></joint></robot>"""
    return "".join([*parts, flange])


def term(robot: Robot, name: str, place: int | None = None) -> Term:
    """An effect in the middle of the arm, or where it is said."""
    effect = registry()[name]
    places = effect.candidates(robot.dof)
    joints = places[len(places) // 2 if place is None else place]
    if name == "payload":
        theta, shape = effect.from_values(np.array(BODY), robot)
    else:
        theta, shape = SIZES[name]
    return Term(effect, joints, tuple(shape), np.array(theta, dtype=float))


def model_with(robot: Robot, *names: str, **changes) -> Model:
    """The rigid body with these effects."""
    terms = tuple(term(robot, name) for name in names)
    given = {"speed_floor": np.full(robot.dof, 0.01), **changes}
    return Model(robot, inertial_parameters(robot.model), terms, **given)


def driven(
    robot: Robot, *more: Term, names: Sequence[str] = DRIVES, floor: float = 0.01
) -> Model:
    """The rigid body with these effects on every joint, and more terms."""
    terms = [term(robot, n, j) for n in names for j in range(robot.dof)]
    body, floors = inertial_parameters(robot.model), np.full(robot.dof, floor)
    return Model(robot, body, (*terms, *more), floors)


# Bars of what a target carries [N m]; that of c99 is per N m of torque.
BARS = {
    "json": 0.0,
    "urdf": 1e-12,
    "mjcf": 1e-9,
    "mujoco": 1e-9,
    "c99": 1e-12,
    "fmu": 1e-9,
    "rrd": 1e-9,
    "table": None,
}
RELATIVE = ("c99", "table")
COMPILED = ("c99", "fmu", "mujoco")
BESIDE = "viscous"  # so that there is a torque where the effect cannot be carried
FEW = ("coulomb", "payload", "elasticity")  # of a quick run


def target_figures(quick: bool) -> Figures:
    """Measure every target; a quick run takes three effects and one arm."""
    arms, names = (ARMS[:1], FEW) if quick else (ARMS, NAMES)
    out: Figures = {}
    for target, bar in BARS.items():
        if target in COMPILED and compiler() is None:
            out[target] = missing(bar, "no C compiler here")
            continue
        made = {(arm, n): _exported(target, arm, n) for arm in arms for n in names}
        entry = _figure(target, bar, made)
        out[target] = partial(entry, "three effects, one arm") if quick else entry
        print(f"{target}: {entry['value']:.3g}", flush=True)
        out[f"{target}_carries"] = _carried(names, made)
    return out


def _exported(target: str, arm: str, name: str) -> Exported:
    robot = robot_of(arm)
    # An MJCF spring holds a constant torque only where there is one.
    return TARGETS[target](model_with(robot, *dict.fromkeys((BESIDE, name))))


def _figure(target: str, bar: float | None, made: dict) -> dict:
    gaps, states = {}, 0
    for (arm, name), each in made.items():
        got, want = BACK[target](each)
        size = max(np.abs(want).max(), 1e-9) if target in RELATIVE else 1.0
        gaps[arm, name] = float(np.abs(got - want).max() / size)
        states += len(want)
    (arm, name), worst = max(gaps.items(), key=lambda item: item[1])
    return figure(
        worst, bar, len(gaps), what=f"{states} states", worst=f"{name}, {arm}"
    )


def _carried(names: Sequence[str], made: dict) -> dict:
    """How many effects are carried; all others must be listed with a torque."""
    lost, silent = {}, []
    for (_, name), each in made.items():
        kept = {t.effect.name for t in _terms(each)}
        left = [one for one in each.left if one.name == name]
        if name not in kept:
            lost[name] = max(lost.get(name, 0.0), *(one.largest for one in left), 0.0)
        if (name in kept) == bool(left):
            silent.append(name)
    left = ", ".join(f"{k} {v:.2g}" for k, v in lost.items()) or "nothing"
    told = f"left out, with the torque that is missing [N m]: {left}"
    entry = figure(len(names) - len(lost), None, len(names), what=told)
    return entry | {"ok": False if silent else None}


def _terms(each: Exported):
    return getattr(each.carried, "model", each.carried).terms


C_BAR = 2.0  # microseconds a row
LEVELS, ROWS, TIMES = 22, 10_000, 7
SINGLE = 500  # rows, one a call
# Of the time of the same row by the call for many: 20 of 174 microseconds.
TABLES_BAR = 0.2
SIGNALS = ("q", "qd", "qdd")


def speed_figures(quick: bool) -> Figures:
    """Time per row of tables alone, and of body, friction and tables compiled."""
    whole, motion = _whole(), exciting(robot_of("irb140"), ROWS / 250)
    told = "rigid body, friction of all joints, 18 tables of 22 levels for each joint"
    out = _single_rows(whole, motion)
    if compiler() is None:
        return out | {"c_microseconds": missing(C_BAR, "no C compiler here")}
    with compiled(to_c99(whole)) as along:
        each, got = _each(lambda: along(motion))
    gap = np.abs(got - whole.along(motion.t, motion.parts)).max()
    out["c_microseconds"] = figure(each, C_BAR, ROWS, what=told)
    return out | {"tables_c": figure(float(gap), 1e-9, ROWS)}


def _single_rows(whole: Corrected, motion: Motion) -> Figures:
    """One row of tables at a time, over that of a call for many."""
    lookup = whole.tables[0].lookup
    saved = dict(np.load(io.BytesIO(export_lookup(lookup)["model.npz"])))
    states, correction = np.hstack(motion.parts)[:SINGLE], by_row(saved)
    quick = _spent(lambda: [correction(x) for x in states])
    call = _spent(lambda: [predict(saved, x[None]) for x in states])
    return {
        "tables_row_over_many": figure(
            quick / call, TABLES_BAR, SINGLE, microseconds=quick
        )
    }


def _spent(run) -> float:
    """Least time of a row [microseconds] of so many calls, one row each."""
    return 1e6 * min(cpu(run) for _ in range(TIMES)) / SINGLE


def _each(run) -> tuple[float, np.ndarray]:
    """Least time of a row [microseconds]: of the processor, whoever else uses it."""
    out = run()
    return 1e6 * min(cpu(run) for _ in range(TIMES)) / ROWS, out


def _whole() -> Corrected:
    """A model with one table per variable on each joint, as of a calibration."""
    robot, rng = robot_of("irb140"), np.random.default_rng(0)
    model = driven(robot)
    columns = tuple((on, (j,), "") for on in SIGNALS for j in range(robot.dof))
    count = len(columns)
    axes = [Axis(k, np.sort(rng.uniform(-2, 2, LEVELS - 1))) for k in range(count)]
    own = (Tables(j, columns, _lookup(axes, rng), MAIN, NEAREST) for j in range(6))
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
