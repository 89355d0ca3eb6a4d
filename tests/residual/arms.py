"""Small arms, and short logs of them, for the tests of the core."""

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from residual.diagnosis.diagnose import diagnose
from residual.diagnosis.findings import NamedEffect, merge_into_findings
from residual.diagnosis.outcome import Outcome, search_effects
from residual.model.nominal import DEFAULT_DECLARED, add_joint_constants, prepare_fit_logs
from residual.recording import Recording
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import Robot, load_robot
from residual.signals.splitting import find_session_start
from residual.signals.track import FilterSettings
from residual.verdict.result import Diagnosis
from sim.engine.plant_records import SyntheticEffect, create_random_stream
from sim.plant.typical_sizes import draw_effect
from tests.synthetic.logs import CHANGES, Case, LogPlan, make_case
from tests.synthetic.quasi_static import Plant

Y, Z = "0 1 0", "0 0 1"
TWO = (Y, Y)
SEVEN = (Z, Y, Z, Y, Z, Y, Z)
LENGTH = 0.35
# Its own orientation and place, so that a mix-up of frames shows.
FLANGE = """<link name="flange"/><joint name="to_flange" type="fixed">
  <parent link="l{last}"/><child link="flange"/>
  <origin xyz="0.3 0.02 0.1" rpy="0.4 0.8 -0.3"/></joint>"""


def urdf_text(axes=TWO, extra=""):
    """URDF of a chain of slender links along x, with a flange of its own frame."""
    parts = ['<robot name="small arm"><link name="l0"/>']
    for i, axis in enumerate(axes, start=1):
        mass = 6.0 / i
        across = mass * LENGTH**2 / 12
        parts.append(
            f"""<link name="l{i}"><inertial>
            <origin xyz="{LENGTH / 2} 0.01 0.02"/><mass value="{mass}"/>
            <inertia ixx="0.02" iyy="{across}" izz="{across}" ixy="0" ixz="0" iyz="0"/>
            </inertial></link>
            <joint name="j{i}" type="revolute">
            <parent link="l{i - 1}"/><child link="l{i}"/>
            <origin xyz="{LENGTH if i > 1 else 0} 0 0"/><axis xyz="{axis}"/>
            <limit lower="-2.5" upper="2.5" velocity="3" effort="200"/></joint>"""
        )
    return "".join([*parts, FLANGE.format(last=len(axes)), extra, "</robot>"])


@cache
def arm(axes=TWO, toml="", extra="") -> Robot:
    """A robot of that many joints, read as a user's folder is."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "arm.urdf").write_text(urdf_text(axes, extra))
        (Path(folder) / "robot.toml").write_text(toml)
        return load_robot(folder)


@cache
def bare_irb140() -> Robot:
    return replace(load_robot("irb140"), declared={})


FAMILIES = ("fourier", "cyclic", "slow_cyclic", "move_stop_move")


def short_case(robot: Robot, *hidden, seed: int, baseline=None, **options) -> Case:
    """Four short fit logs and one held out, with effects named or given as Hidden.

    Options: ``duration`` and ``rate`` of each log, ``joint`` for drawn effects.
    """
    joint = options.pop("joint", None)
    options = {"duration": 7.0, "rate": 125.0, **options}
    effects = tuple(
        h
        if isinstance(h, SyntheticEffect)
        else draw_effect(robot, h, create_random_stream(seed, f"draw/{h}"), joint)
        for h in hidden
    )
    if baseline is None:
        baseline = any(h.name in CHANGES for h in effects)
    parts = ["baseline", "fit"] if baseline else ["fit"]
    plan = [LogPlan(f"{p}_{f}", p, f, **options) for p in parts for f in FAMILIES]
    plan.append(LogPlan("held_out", "held_out", "fourier", **options))
    return make_case(Plant(robot, effects, seed), tuple(plan))


def diagnose_case(case: Case, declared=None, **changes) -> Diagnosis:
    """The whole method on a case, some of its inputs replaced."""
    inputs = {
        "robot": case.robot,
        "fit": case.fit,
        "baseline": case.baseline,
        "held_out": case.held_out,
        "declared": declared,
        **changes,
    }
    return diagnose(**inputs)


def names(verdict) -> list[tuple[str, tuple[int, ...]]]:
    return [(f.name, f.joints) for f in verdict.effects]


def smooth_motion(robot: Robot, t):
    """Slow sines with exact derivatives, different for every joint."""
    w = 2 * np.pi * (0.2 + 0.07 * np.arange(robot.dof))
    angle = t[:, None] * w + np.arange(robot.dof)
    q = 0.6 * np.sin(angle)
    return q, 0.6 * w * np.cos(angle), -0.6 * w**2 * np.sin(angle)


def plain_logs(robot: Robot, moving, torque, count=4, seed=0) -> list[Recording]:
    """Logs of 8 s at 125 Hz: sines on some joints (from 0), friction and noise on all.

    A torque [N m] is added to each joint. Shape (dof,).
    """
    keep, out = np.isin(range(robot.dof), moving), []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        t = np.arange(1000) / 125
        w = rng.uniform(1, 3, (2, robot.dof))
        angle = t[:, None, None] * w + rng.uniform(0, 6, (2, robot.dof))
        q = keep * (0.5 * np.sin(angle)).sum(axis=1)
        qd = keep * (0.5 * w * np.cos(angle)).sum(axis=1)
        qdd = keep * (-0.5 * w**2 * np.sin(angle)).sum(axis=1)
        tau = compute_inverse_dynamics(robot.model, q, qd, qdd)
        tau += 3 * np.tanh(qd / 0.01) + 2 * qd + torque
        tau += 0.1 * rng.normal(size=q.shape)
        out.append(recording(20.0 * k + t, q + 0.1, tau, f"log{k}"))
    return out


def recording(t, q, tau, label="log") -> Recording:
    return Recording(label, "any", t, q, tau)


def searched(case: Case, declared=DEFAULT_DECLARED) -> tuple[Outcome, list[NamedEffect]]:
    """Search and findings without the proof."""
    clock = find_session_start(case.fit)
    logs = prepare_fit_logs(case.robot, case.fit, clock, FilterSettings())
    assert not case.baseline, "what changed is compared: diagnose_case"
    outcome = search_effects(logs, add_joint_constants(logs, declared), quiet)
    return outcome, merge_into_findings(outcome, outcome.fit, outcome.named)


def quiet(stage, share):
    """Progress that nobody watches."""
