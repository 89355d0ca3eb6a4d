"""Errors: of the paper's table 1 on a frozen set, and of measured arms.

The frozen set: IRB 140 whose gears stick (Fs = 1.5 Fc, 0.05 rad/s), pull harder one way
(10 % of Fc) and under load (5 %), torque noise 1 % of range; six runs of 20 s, two
periods each. The twin knows rigid body and rotors alone, or friction as well.

Measured: unseen runs and unseen blocks of real arms.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.harness.figures import Figures, figure, missing
from benchmarks.measured_parts.arms import data_folder
from flows.steps.experiment import with_twins
from residual.calibration.calibrate import Calibration, Settings, calibrate
from residual.calibration.rows import Run
from residual.calibration.scores import (
    BLOCK,
    DEFAULT,
    LS,
    NOTHING,
    PAPER_FORM,
    PLSR,
    RANDOM,
    RUN,
    Score,
    find,
)
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from sim.engine.records import Noise, PlantEffect, PlantSpec, Rates, TrajectorySpec
from sim.experiment import run_experiment
from sim.plant import tables as at
from sim.trajectories import make_reference
from sim.twin import twin_of
from warehouse.logs import read_log

HALF, NOT_WORSE = 0.5, 1.03
BARS = (
    ("paper_form_over_ls_random", HALF),
    ("paper_form_over_ls_unseen", 1.0),
    ("default_over_ls_unseen", HALF),
    ("paper_declared_default_over_none", NOT_WORSE),
)
_SEED = 2017
_FAMILIES = (*2 * ("fourier",), *2 * ("move_stop_move",), *2 * ("cyclic",))


def paper_set_figures(quick: bool) -> Figures:
    """Return the figures of the frozen set.

    Args:
        quick: Whether to leave all of them to the full run: six runs take a minute, and
            fewer do not show what more of them do.
    """
    if quick:
        return {name: missing(bar, "the full run measures it") for name, bar in BARS}
    out = _frozen_figures(_calibrated_set(frozen_runs(0)))
    out["paper_declared_default_over_none"] = over_none(_calibrated_set(frozen_runs(1)))
    return out


def frozen_runs(side: int) -> list[Run]:
    """Return the six runs, against a twin without friction (0) or with it (1)."""
    return [_simulated(number)[side] for number in range(len(_FAMILIES))]


def _calibrated_set(runs: list[Run]) -> Calibration:
    return calibrate(_irb140(), runs, Settings(paper=True, views=False))


@cache
def _simulated(number: int) -> tuple[Run, Run]:
    """One run, against a twin without friction and against one with it."""
    robot, family = _irb140(), _FAMILIES[number]
    rates = Rates()
    spec = TrajectorySpec(family, 20.0, 2, _SEED + number)
    reference = make_reference(robot, spec, rates.control)
    made = run_experiment(robot, reference, _plant(robot), rates, 30.0 * number)
    log = replace(made.log, id=f"{family} {number + 1}")
    every = round(rates.control / rates.log)
    drive = twin_of(_without_friction(robot), reference).rows[::every, at.DRIVE]
    bare = Run(log, family, {"e_tau": log.tau - drive[: len(log.t)]})
    return bare, Run(log, family, made.twin)


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
    return PlantSpec(tuple(effects), scatter=0.0, noise=Noise(torque=0.01), seed=_SEED)


def _frozen_figures(made: Calibration) -> Figures:
    """The paper's table 1, and what it does not show."""
    pairs = {
        "paper_form_over_ls_random": (RANDOM, PAPER_FORM, True),
        "paper_form_over_ls_unseen": (RUN, PAPER_FORM, False),
        "default_over_ls_unseen": (RUN, DEFAULT, True),
    }
    out = {}
    for name, (scheme, model, at_most) in pairs.items():
        one, ls = find(made.scores, scheme, model), find(made.scores, scheme, LS)
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
_LOADED = "load"  # in the name of a log: another arm than that of the others
BEST = 1.02  # of what anyone would try first, on every scheme
# Of each arm: model, what it is held against, the least ratio that is a failure.
_PAIRS = (
    ("default_over_none", DEFAULT, NOTHING, NOT_WORSE),
    ("paper_form_over_none", PAPER_FORM, NOTHING, None),
)
_NO_BAR = "for information, no bar of its own"


def measured_figures(quick: bool) -> Figures:
    """Return the figures of the measured arms; all are left to the full run."""
    folder = data_folder()
    why = "the full run measures it"
    if folder is None:
        why = "no measured logs: neither ../shared/data nor $MODELGAP_DATA"
    out: Figures = {}
    for arm in ARMS:
        if quick or folder is None:
            out[f"{arm}_default_over_none"] = missing(NOT_WORSE, why)
            out[f"{arm}_default_over_best"] = missing(BEST, why)
            for name, _, _, bar in _PAIRS:
                out[f"{arm}_blocks_{name}"] = missing(bar, why)
            continue
        made = _calibrated(folder / arm)
        out[f"{arm}_default_over_none"] = over_none(made)
        out[f"{arm}_default_over_best"] = over_best(made)
        for name, one, other, bar in _PAIRS:
            out[f"{arm}_blocks_{name}"] = _ratio(made, one, other, bar)
        own = [name for name in out if name.startswith(arm)]
        print(*(f"{name}: {out[name]}" for name in own), sep="\n", flush=True)
    name = "kr300_paper_default_over_best"
    if quick or folder is None:
        return out | {name: missing(BEST, why)}
    robot, logs = _read(folder / "kr300")
    runs = with_twins(robot, [Run(log) for log in logs])
    made = calibrate(robot, runs, Settings(paper=True, views=False))
    return out | {name: over_best(made)}


def over_none(made: Calibration) -> dict:
    """The default form against no compensation, the worst joint on unseen runs."""
    one, none = (find(made.scores, RUN, model) for model in (DEFAULT, NOTHING))
    ratios = one.rmsev / none.rmsev
    return figure(
        float(ratios.max()),
        NOT_WORSE,
        len(ratios),
        ratios=rounded(ratios),
        percent=rounded(one.rmsev),
        none_percent=rounded(none.rmsev),
        options=[o.kind for o in made.chosen],
    )


def over_best(made: Calibration) -> dict:
    """The default form against the best of nothing, LS and PLSR, its worst scheme.

    All joints together; PLSR with the number of components that does best there.
    """
    ratios = {}
    for scheme in dict.fromkeys(one.scheme for one in made.scores):
        ours, *others = (
            find(made.scores, scheme, model).overall
            for model in (DEFAULT, NOTHING, LS, PLSR)
        )
        ratios[scheme] = round(ours / min(others), 4)
    return figure(max(ratios.values()), BEST, len(ratios), ratios=ratios)


def rounded(values: np.ndarray) -> list[float]:
    """Return numbers as they are recorded."""
    return [round(float(v), 3) for v in values]


def _calibrated(folder: Path) -> Calibration:
    robot, logs = _read(folder)
    runs, settings = [Run(log) for log in logs], Settings(views=False)
    return calibrate(robot, runs, settings)


def _read(folder: Path) -> tuple[Robot, list[Recording]]:
    robot = load_robot(folder / f"{folder.name}.urdf")
    paths = [p for p in sorted(folder.glob("*.csv")) if _LOADED not in p.stem]
    return robot, [read_log(str(path), robot)[0] for path in paths]


def _ratio(made: Calibration, model: str, other: str, bar: float | None) -> dict:
    """Error of one model over that of another, over all joints, on unseen blocks."""
    # The parts of a single log are its runs here.
    scheme = BLOCK if find(made.scores, BLOCK, NOTHING) else RUN
    pair = [find(made.scores, scheme, name) for name in (model, other)]
    value, interval = _interval(*pair)
    told = {"interval": rounded(interval), "joints": _joints(*pair)}
    told |= {"percent": rounded(pair[0].rmsev), "all": round(pair[0].overall, 3)}
    told |= {"other_percent": rounded(pair[1].rmsev)}
    if bar is None:
        told["why"] = _NO_BAR
    return figure(value, bar, len(pair[0].miss), **told)


def _interval(one: Score, other: Score) -> tuple[float, np.ndarray]:
    """Ratio of errors over all joints, and where it lies in 95 of 100 draws of folds.

    Folds are drawn with replacement, both models of a fold together: the percentile
    bootstrap of Efron and Tibshirani (1993, ch. 13).
    """
    misses = np.stack([one.miss.sum(axis=1), other.miss.sum(axis=1)])
    folds, rng = misses.shape[1], np.random.default_rng(0)
    drawn = misses[:, rng.integers(folds, size=(2000, folds))].sum(axis=2)
    ratios = np.sqrt(drawn[0] / np.maximum(drawn[1], 1e-300))
    value = one.overall / max(other.overall, 1e-300)
    return value, np.quantile(ratios, [0.025, 0.975])


def _joints(one: Score, other: Score) -> list[float]:
    return rounded(one.rmsev / other.rmsev)
