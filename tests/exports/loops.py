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

from flows.steps.export import build
from residual.effects import registry
from residual.export.c99 import prefix_of, to_c99
from residual.export.exported import Exported, Motion, exciting
from residual.model.model import Model
from residual.robot.dynamics import inverse_dynamics
from tests.exports import back, models

HELD, SECONDS, STEP = 1e-3, 10.0, 1e-4  # s
STIFF, DAMPED = 400.0, 40.0  # 1/s^2, 1/s of the loop
SHOULDER = 1
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
