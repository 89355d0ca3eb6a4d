"""Group 1: what must be exact: base parameters, power, URDF round trip."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.figures import Figures, figure
from benchmarks.identification_parts.energy import power_miss
from benchmarks.identification_parts.plant_logs import ROBOT, plant_logs
from residual.identification.identify import identify
from residual.model.export import robot_files
from residual.model.nominal import prepare_logs, start_nominal
from residual.robot import dynamics
from residual.robot.base_parameters import base_parameters
from residual.robot.robot import load_robot

STATES = 1000


def identity_figures() -> Figures:
    """Measure identities on random states, and a model that is written and reloaded."""
    motion = tuple(np.random.default_rng(1).uniform(-2, 2, (3, STATES, ROBOT.dof)))
    base = base_parameters(ROBOT.model)
    theta = base.mapping @ dynamics.inertial_parameters(ROBOT.model)
    rows = dynamics.regressor(ROBOT.model, *motion)[:, :, base.columns]
    tau = rows @ theta
    rnea = dynamics.inverse_dynamics(ROBOT.model, *motion)
    return {
        "base_against_rnea": figure(
            float(np.abs(tau - rnea).max()),
            1e-9,
            STATES,
            unit="N m",
            parameters=len(base),
            gap=base.gap,
        ),
        "power_balance": figure(
            power_miss(ROBOT.model, motion, tau), 1e-6, STATES, unit="relative"
        ),
        "urdf_round_trip": figure(_round_trip(), 1e-9, 1, unit="N m"),
    }


def _round_trip() -> float:
    """Largest torque difference of an identified model once written and reloaded."""
    fit, held_out = plant_logs(1)
    found = identify(ROBOT, fit)
    names = list(dict.fromkeys(t.effect.name for t in found.model.terms))
    with tempfile.TemporaryDirectory() as folder:
        for name, content in robot_files(found.model).items():
            (Path(folder) / name).write_bytes(content)
        robot = load_robot(folder)
    again = start_nominal(
        prepare_logs(robot, fit, None, found.model.filters), names
    ).model
    again = replace(
        again,
        speed_floor=found.model.speed_floor,
        standstill=found.model.standstill,
        clock=found.model.clock,
    )
    gaps = [np.abs(again.predict(r) - found.model.predict(r)).max() for r in held_out]
    return float(max(gaps))
