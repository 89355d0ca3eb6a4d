"""Errors of PLSR: the paper's table 1 on a simulated set, and measured arms.

The set: IRB 140 with stiction (Fs = 1.5 Fc, 0.05 rad/s), direction-dependent friction
(10 % of Fc) and load friction (5 %), torque noise of 1 % of the range; six runs of
20 s, two periods each. The twin has rigid body and rotors alone, or friction as well.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from benchmarks.harness.figures import FULL, NO_LOGS, Figures, all_missing, figure, missing
from benchmarks.harness.rates import rounded
from benchmarks.measured_parts.arms import data_folder
from residual.calibration.calibrate import Calibration, CalibrationSettings, calibrate
from residual.calibration.calibration_rows import CalibrationRun
from residual.calibration.validation_scores import (
    DEFAULT,
    LS,
    NOTHING,
    PAPER_FORM,
    PLSR,
    RANDOM,
    RUN,
)
from residual.calibration.validation_scores import find_model_score as score
from residual.robot.robot import Robot, load_robot
from sim.engine.plant_records import PlantEffect, PlantSpec, SampleRates, SensorNoise
from sim.engine.plant_records import TrajectorySpec as Trajectory
from sim.experiment import run_experiment, simulate_nominal_twin
from sim.plant import step_tables as at
from sim.trajectories import plan_reference_motion
from warehouse.logs import read_log

HALF, NOT_WORSE = 0.5, 1.03
BARS = {
    "paper_form_over_ls_random": HALF,
    "paper_form_over_ls_unseen": 1.0,
    "default_over_ls_unseen": HALF,
    "paper_declared_default_over_none": NOT_WORSE,
}
_SEED = 2017
_FAMILIES = (*2 * ("fourier",), *2 * ("move_stop_move",), *2 * ("cyclic",))


def paper_set_figures(quick: bool) -> Figures:
    """Return the figures of the frozen set; a quick run measures none."""
    if quick:
        return all_missing(BARS, FULL)
    settings = CalibrationSettings(paper=True, with_figures=False)
    runs = zip(*map(_simulated, range(len(_FAMILIES))), strict=True)
    bare, declared = (calibrate(_irb140(), of, settings) for of in runs)
    return _frozen_figures(bare) | {"paper_declared_default_over_none": over_none(declared)}


def _simulated(number: int) -> tuple[CalibrationRun, CalibrationRun]:
    """One run, against a twin without friction and against one with it."""
    robot, family = _irb140(), _FAMILIES[number]
    rates = SampleRates()
    spec = Trajectory(family, 20.0, 2, _SEED + number)
    ref = plan_reference_motion(robot, spec, rates.control)
    made = run_experiment(robot, ref, _plant(robot), rates, 30.0 * number)
    log = replace(made.log, id=f"{family} {number + 1}")
    every = round(rates.control / rates.log)
    drive = simulate_nominal_twin(_without_friction(robot), ref).rows[::every, at.DRIVE]
    bare = CalibrationRun(log, family, {"e_tau": log.tau - drive[: len(log.t)]})
    return bare, CalibrationRun(log, family, made.twin)


def _without_friction(robot: Robot) -> Robot:
    """The arm whose friction is declared to be nothing; left out, it would be usual."""
    nothing = {
        name: replace(robot.declared[name], values={key: np.zeros(robot.dof)})
        for name, key in (("coulomb", "level"), ("viscous", "coefficient"))
    }
    return replace(robot, declared={**robot.declared, **nothing})


def _plant(robot: Robot) -> PlantSpec:
    levels = np.asarray(robot.declared["coulomb"].values["level"])
    effects = []
    for joint, level in enumerate(levels, 1):
        sticks = (("level", 0.5 * level), ("velocity", 0.05))
        effects += [
            PlantEffect("stribeck", (joint,), sticks),
            PlantEffect("coulomb_asymmetry", (joint,), (("level", 0.1 * level),)),
            PlantEffect("load_friction", (joint,), (("coefficient", 0.05),)),
        ]
    noise = SensorNoise(torque=0.01)
    return PlantSpec(tuple(effects), scatter=0.0, noise=noise, seed=_SEED)


def _frozen_figures(calibration: Calibration) -> Figures:
    """The paper's table 1, and what it does not show."""
    pairs = {
        "paper_form_over_ls_random": (RANDOM, PAPER_FORM, True),
        "paper_form_over_ls_unseen": (RUN, PAPER_FORM, False),
        "default_over_ls_unseen": (RUN, DEFAULT, True),
    }
    out = {}
    for name, (scheme, model, at_most) in pairs.items():
        one, ls = (score(calibration.scores, scheme, model), score(calibration.scores, scheme, LS))
        ratios = one.rmsev / ls.rmsev
        told = {"ratios": rounded(ratios), "percent": rounded(one.rmsev)}
        told |= {"ls_percent": rounded(ls.rmsev), "components": one.components}
        told["together"] = round(one.overall / ls.overall, 4)
        if at_most:
            out[name] = figure(float(ratios.max()), HALF, len(ratios), **told)
            continue
        # It must be seen to fail: the joint where it fails least.
        value = float(ratios.min())
        told |= {"ok": value > 1, "at_least": True}
        out[name] = figure(value, 1.0, len(ratios), **told)
    return out


@cache
def _irb140() -> Robot:
    return load_robot("irb140")


ARMS = ("kr300", "ur10", "lwr4", "ur10e")
_LOADED = "load"  # in the name of a log of another arm than the others
BEST = 1.02


def measured_figures(quick: bool) -> Figures:
    """Return the figures of the measured arms; a quick run measures none."""
    folder = data_folder()
    why = FULL if folder else NO_LOGS
    out: Figures = {}
    for arm in ARMS:
        if quick or folder is None:
            out[f"{arm}_default_over_none"] = missing(NOT_WORSE, why)
            out[f"{arm}_default_over_best"] = missing(BEST, why)
            continue
        robot = load_robot(folder / arm / f"{arm}.urdf")
        paths = sorted((folder / arm).glob("*.csv"))
        logs = [read_log(str(p), robot)[0] for p in paths if _LOADED not in p.stem]
        calibration = calibrate(
            robot, [CalibrationRun(log) for log in logs], CalibrationSettings(with_figures=False)
        )
        out[f"{arm}_default_over_none"] = over_none(calibration)
        out[f"{arm}_default_over_best"] = over_best(calibration)
    return out


def over_none(calibration: Calibration) -> dict:
    """Compare the default form with no compensation, worst joint on unseen runs."""
    one, none = (score(calibration.scores, RUN, model) for model in (DEFAULT, NOTHING))
    ratios = one.rmsev / none.rmsev
    return figure(
        float(ratios.max()),
        NOT_WORSE,
        len(ratios),
        ratios=rounded(ratios),
        options=[o.kind for o in calibration.chosen],
    )


def over_best(calibration: Calibration) -> dict:
    """Compare the default form with the best of none, LS and PLSR, worst scheme.

    All joints together; PLSR with the number of components that does best there.
    """
    ratios = {}
    for scheme in dict.fromkeys(one.scheme for one in calibration.scores):
        ours, *others = (
            score(calibration.scores, scheme, model).overall
            for model in (DEFAULT, NOTHING, LS, PLSR)
        )
        ratios[scheme] = round(ours / min(others), 4)
    return figure(max(ratios.values()), BEST, len(ratios), ratios=ratios)
