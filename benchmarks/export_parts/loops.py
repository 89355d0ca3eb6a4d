"""Closed loops in MuJoCo, against the same model integrated here; friction that creeps.

Both have the same drive: torque of the rigid body along three sines, which knows none
of the effects, and feedback, held for a millisecond. Ours is the exported header alone
(which has the model's torque to rounding): M(q) and the rest by its torque at unit
accelerations, semi-implicit steps. MuJoCo has its own bodies and its own integrator,
and of the effects what MJCF has words for, or the callback.
"""

import ctypes
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.export_parts import back, models
from benchmarks.harness.figures import Figures, figure, missing
from flows.steps.export import build, compiler
from residual.effects import registry
from residual.export.c99 import prefix_of, to_c99
from residual.export.exported import Exported, Motion, exciting
from residual.export.mujoco import to_mujoco
from residual.export.simulators import STEP as PERIOD
from residual.export.simulators import to_mjcf
from residual.model.model import Model
from residual.robot.dynamics import inverse_dynamics, mass_matrix

HELD, SECONDS, STEP = 1e-3, 10.0, 1e-4  # s
STIFF, DAMPED = 400.0, 40.0  # 1/s^2, 1/s of the loop
SHOULDER = 1
FEW = ("stribeck", "load_friction", "ripple")  # of a quick run
BAR = 100.0  # microradians
SHORT = 1e-3  # of its value: what friction may lack where the joint creeps
MJCF_SECONDS, SUBSTEPS = 2.0, 5  # s; steps of ours per step of MuJoCo
OURS = """
#include <string.h>
#include "{header}"
enum {{ N = {dof} }};
static void solve(double a[N][N], double *x)
{{
    for (int p = 0; p < N; p++)
        for (int i = p + 1; i < N; i++) {{
            const double f = a[i][p] / a[p][p];
            for (int j = p; j < N; j++) a[i][j] -= f * a[p][j];
            x[i] -= f * x[p];
        }}
    for (int p = N - 1; p >= 0; p--) {{
        for (int j = p + 1; j < N; j++) x[p] -= a[p][j] * x[j];
        x[p] /= a[p][p];
    }}
}}
static void torque(const {p}_memory *memory, double t, const double *q,
                   const double *qd, const double *qdd, double *out)
{{
    {p}_memory own = *memory;
    {p}_torque(&own, t, q, qd, qdd, out);
}}
void go(int n, int steps, double held, double stiff, double damped,
        const double *goal, const double *rate, const double *forward,
        const double *scale, double *out)
{{
    {p}_memory memory;
    {p}_start(&memory);
    double q[N], qd[N], a[N] = {{0.0}}, drive[N], rest[N];
    memcpy(q, goal, sizeof q), memcpy(qd, rate, sizeof qd);
    for (int k = 0; k < n; k++) {{
        memcpy(out + N * k, q, sizeof q);
        for (int i = 0; i < N; i++)
            drive[i] = forward[N * k + i] + scale[i] * (
                stiff * (goal[N * k + i] - q[i]) + damped * (rate[N * k + i] - qd[i]));
        for (int s = 0; s < steps; s++) {{
            const double h = held / steps, t = k * held + s * h;
            for (int round = 0; round < 3; round++) {{
                double mass[N][N], more[N], step[N];
                torque(&memory, t, q, qd, a, rest);
                for (int j = 0; j < N; j++) {{
                    memcpy(step, a, sizeof a);
                    step[j] += 1.0;
                    torque(&memory, t, q, qd, step, more);
                    for (int i = 0; i < N; i++) mass[i][j] = more[i] - rest[i];
                }}
                for (int i = 0; i < N; i++) step[i] = drive[i] - rest[i];
                solve(mass, step);
                for (int i = 0; i < N; i++) a[i] += step[i];
            }}
            {p}_torque(&memory, t, q, qd, a, rest);
            for (int i = 0; i < N; i++) qd[i] += h * a[i], q[i] += h * qd[i];
        }}
    }}
}}
"""


def loop_figures(quick: bool) -> Figures:
    """Measure how far the two loops part with the callback, an effect at a time."""
    what = "mujoco_loop_apart"
    if compiler() is None:
        return {what: missing(BAR, "no C compiler here")}
    apart: dict[str, float] = {}
    for name in FEW if quick else models.NAMES:
        made = to_mujoco(with_effect(models.ARMS[0], name))
        if name in {t.effect.name for t in made.carried.terms}:
            apart[name] = 1e6 * loops_apart(made, 2.0 if quick else SECONDS)
            print(f"{name}: {apart[name]:.3g} microradians", flush=True)
    worst = max(apart, key=apart.get)
    left = [name for name in models.NAMES if name not in apart and not quick]
    told = f"{worst}; cannot be in it: {', '.join(left) or 'none'}"
    return {what: figure(apart[worst], BAR, len(apart), what=told)}


def mujoco_figures(quick: bool) -> Figures:
    """Friction at 1e-3 rad/s, and how far the two loops part without a callback."""
    arms = models.ARMS[:1] if quick else models.ARMS
    short = max(_short(arm) for arm in arms)
    out = {"mjcf_friction_short": figure(short, SHORT, 2 * len(arms))}
    if compiler() is None:
        return out | {"mjcf_loop_apart": missing(None, "no C compiler here")}
    loops = {arm: _mjcf_loop(arm) for arm in arms}
    apart = max(a for a, _ in loops.values())
    told = {arm: f"{1e6 * t:.3g}" for arm, (_, t) in loops.items()}
    return out | {
        "mjcf_loop_apart": figure(
            1e6 * apart, None, len(arms), what=f"error of the loop itself {told} µrad"
        )
    }


def _short(arm: str) -> float:
    """By how much dry friction falls short of its value, as a share of it."""
    robot = models.robot_of(arm)
    whole = models.model_with(robot, "coulomb", speed_floor=np.full(robot.dof, 1e-5))
    (own,) = whole.terms
    (j,), zero = own.joints, np.zeros((2, robot.dof))
    qd = back.CREEP * np.array([[1.0], [-1.0]]) * np.ones(robot.dof)
    states = Motion(np.arange(2.0), zero, qd, zero)
    up, down = back.inverse(back.text_of(to_mjcf(whole)), states)[:, j]
    return float(1 - (up - down) / 2 / own.theta[0])


def _mjcf_loop(arm: str) -> tuple[float, float]:
    """Largest distance of the loops, and of ours from its reference [rad]."""
    import mujoco

    robot = models.robot_of(arm)
    more = models.term(robot, "payload"), models.term(robot, "spring", 1)
    model = models.driven(robot, *more, floor=1e-3)
    motion = exciting(robot, MJCF_SECONDS, 1 / PERIOD)
    scale = np.diag(mass_matrix(robot.model, motion.q[:1])[0]) + 0.6
    drive = inverse_dynamics(robot.model, *motion.parts), scale
    simulated = mujoco.MjModel.from_xml_string(back.text_of(to_mjcf(model)))
    theirs = _theirs(simulated, motion, drive, 1)
    ours = _ours(model, motion, drive, SUBSTEPS)
    return float(np.abs(theirs - ours).max()), float(np.abs(ours - motion.q).max())


def with_effect(arm: str, name: str) -> Model:
    """Rotors and viscous friction of all joints, and one effect."""
    robot, always = models.robot_of(arm), ("viscous", "rotor_inertia")
    # On the joint that bears most, where it has a joint of its own.
    place = SHOULDER if registry()[name].scope == "local" else None
    more = () if name in always else (models.term(robot, name, place),)
    return models.driven(robot, *more, names=always)


def loops_apart(made: Exported, seconds: float, step: float = STEP) -> float:
    """Return the largest distance of MuJoCo's loop from ours [rad]."""
    robot = made.carried.robot
    motion, times = exciting(robot, seconds, 1 / HELD), round(HELD / step)
    drive = inverse_dynamics(robot.model, *motion.parts), np.ones(robot.dof)
    with back.passive(made, step) as simulated:
        theirs = _theirs(simulated, motion, drive, times)
    return float(np.abs(theirs - _ours(made.carried, motion, drive, times)).max())


def _theirs(model, motion: Motion, drive: tuple, times: int) -> np.ndarray:
    import mujoco

    (forward, scale), out = drive, np.empty_like(motion.q)
    model.actuator_ctrllimited[:] = 0
    model.jnt_limited[:] = 0
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = motion.q[0], motion.qd[0]
    for k in range(len(out)):
        out[k] = data.qpos
        back = STIFF * (motion.q[k] - data.qpos)
        back += DAMPED * (motion.qd[k] - data.qvel)
        data.ctrl[:] = forward[k] + scale * back
        for _ in range(times):
            mujoco.mj_step(model, data)
    return out


def _ours(model: Model, motion: Motion, drive: tuple, times: int) -> np.ndarray:
    whole = to_c99(model)
    ((name, text),) = whole.files.items()
    p, dof = prefix_of(name.removesuffix(".h")), motion.q.shape[1]
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / name).write_bytes(text)
        source = OURS.format(header=name, p=p, dof=dof)
        (place / "ours.c").write_text(source, encoding="utf-8")
        build(place, ["ours.c"], "ours.so")
        library = ctypes.CDLL(str(place / "ours.so"))
        out = np.empty_like(motion.q)
        arrays = [motion.q, motion.qd, *drive, out]
        ends = [np.ascontiguousarray(x) for x in arrays[:-1]]
        places = [x.ctypes.data_as(ctypes.c_void_p) for x in (*ends, out)]
        numbers = map(ctypes.c_double, (HELD, STIFF, DAMPED))
        library.go(len(out), times, *numbers, *places)
    return out
