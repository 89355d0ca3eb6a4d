"""Errors: of the paper's table 1 on a frozen set, of sparse tables, of measured arms.

The frozen set: IRB 140 whose gears stick (Fs = 1.5 Fc, 0.05 rad/s), pull harder one way
(10 % of Fc) and under load (5 %), torque noise 1 % of range; six runs of 20 s, two
periods each. The twin knows rigid body and rotors alone, or friction as well.

Sparse: levels are chosen on four runs and judged on four others, against every number
of levels and components judged on these others themselves: the best that hindsight
could have taken. Measured: unseen runs and unseen blocks of real arms.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.harness.figures import Figures, figure, missing
from benchmarks.measured_parts.arms import data_folder
from benchmarks.plsr_parts.speed import repeated_rows
from flows.steps.experiment import with_twins
from residual.calibration.calibrate import Calibration, Settings, calibrate
from residual.calibration.choice import Training, chosen_lookup, corrected
from residual.calibration.methods import (
    DEFAULT,
    EFFECTS,
    LS,
    NONE,
    PAPER_FORM,
    PLSR,
    Forms,
    methods,
)
from residual.calibration.rows import Rows, Run, paper_rows
from residual.calibration.scores import (
    BLOCK,
    RANDOM,
    RUN,
    Score,
    find,
    ratio_interval,
    relative_error,
)
from residual.method.diagnose import diagnose
from residual.model.model import Term
from residual.recording import Array, Recording
from residual.robot.robot import Robot, load_robot
from residual.tables.form import PAIR_FORM, EffectForm
from residual.tables.lookup import Lookup
from residual.tables.nominal_choice import SWEEP, choose_levels
from residual.tables.nominal_pls import NominalForm, fill_unvisited, fit_nominal_pls
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
    ("default_over_none", DEFAULT, NONE, NOT_WORSE),
    ("default_over_named", DEFAULT, EFFECTS, None),
    ("paper_form_over_none", PAPER_FORM, NONE, None),
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
    one, none = (find(made.scores, RUN, model) for model in (DEFAULT, NONE))
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
            for model in (DEFAULT, NONE, LS, PLSR)
        )
        ratios[scheme] = round(ours / min(others), 4)
    return figure(max(ratios.values()), BEST, len(ratios), ratios=ratios)


def rounded(values: np.ndarray) -> list[float]:
    """Return numbers as they are recorded."""
    return [round(float(v), 3) for v in values]


def _calibrated(folder: Path) -> Calibration:
    robot, logs = _read(folder)
    runs, settings = [Run(log) for log in logs], Settings(views=False)
    return calibrate(robot, runs, settings, _named(robot, logs))


def _read(folder: Path) -> tuple[Robot, list[Recording]]:
    robot = load_robot(folder / f"{folder.name}.urdf")
    paths = [p for p in sorted(folder.glob("*.csv")) if _LOADED not in p.stem]
    return robot, [read_log(str(path), robot)[0] for path in paths]


def _named(robot: Robot, logs: list[Recording]) -> tuple[Term, ...]:
    """What a diagnosis of all logs names: its names have seen every block."""
    models = diagnose(robot, logs).models
    return models["augmented"].terms[len(models["nominal"].terms) :]


def _ratio(made: Calibration, model: str, other: str, bar: float | None) -> dict:
    """Error of one model over that of another, over all joints, on unseen blocks."""
    # The parts of a single log are its runs here.
    scheme = BLOCK if find(made.scores, BLOCK, NONE) else RUN
    pair = [find(made.scores, scheme, name) for name in (model, other)]
    if None in pair:
        return missing(bar, "the diagnosis names nothing")
    ratio = ratio_interval(*pair, np.random.default_rng(0))
    told = {"interval": rounded([ratio.low, ratio.high]), "joints": _joints(*pair)}
    told |= {"percent": rounded(pair[0].rmsev), "all": round(pair[0].overall, 3)}
    told |= {"other_percent": rounded(pair[1].rmsev)}
    if bar is None:
        told["why"] = _NO_BAR
    return figure(ratio.value, bar, ratio.folds, **told)


def _joints(one: Score, other: Score) -> list[float]:
    return rounded(one.rmsev / other.rmsev)


_WORSE, _SHARE, _NEAR, _BEATS = 1.02, 0.1, 1.01, 0.8
_FRESH = (101, 102, 103)
_PAPER = NominalForm(components=30)
_DENSE = replace(PAIR_FORM, sparsity=0.0)
_COMPONENTS = 15


def sparse_figures(quick: bool) -> Figures:
    """Return the figures; the frozen set is left to the full run."""
    out: Figures = {}
    for side, name in enumerate(("bare", "declared")):
        keys = (f"sparse_{name}_over_better", f"sparse_{name}_cells")
        if quick:
            why = "the full run measures it"
            out |= {
                k: missing(b, why) for k, b in zip(keys, (_WORSE, _SHARE), strict=True)
            }
            continue
        out |= _sparse(paper_rows(frozen_runs(side)), keys)
    ratios = [_chosen_over_best(seed) for seed in _FRESH[: 1 if quick else None]]
    entry = figure(max(ratios), _NEAR, len(ratios), ratios=_rounded(ratios))
    if quick:
        entry |= {"ok": None, "why": "one set; the full run takes three"}
    return out | {"chosen_levels_over_best_of_sweep": entry}


def _sparse(rows: Rows, keys: tuple[str, str]) -> Figures:
    """Unseen-run error of sparse pair tables over that of the better dense form."""
    training = Training(rows.X, rows.Y, rows.run, rows.tau, rows.part, rows.second)
    loads = tuple((v, len(rows.names) + i) for i, v in enumerate(rows.velocities))
    form = EffectForm(velocities=rows.velocities, loads=loads)
    forms = {"sparse": form, "default": replace(form, pairs=_DENSE)}
    held = [rows.run == run for run in np.unique(rows.run)]
    miss = {name: np.zeros(len(rows.joints)) for name in ("none", *forms)}
    cells = {name: [] for name in forms}
    paper = []
    for out in held:
        kept, new = training.rows(~out), training.rows(out)
        miss["none"] += (new.Y**2).sum(axis=0)
        for name, own in forms.items():
            lookup = chosen_lookup(kept, own)
            miss[name] += ((new.Y - corrected(lookup, new)) ** 2).sum(axis=0)
            cells[name].append(_cells(lookup))
        made = methods(Forms(form, _PAPER))[PAPER_FORM](kept)(new)
        paper.append([((new.Y - one) ** 2).sum(axis=0) for one in made])
    # As the paper takes it: the number of components that does best on these runs.
    curve = np.sum(paper, axis=0)
    miss["paper"] = curve[curve.sum(axis=1).argmin()]
    power = (rows.tau**2).sum(axis=0).sum()
    percent = {k: float(relative_error(m.sum(), power)) for k, m in miss.items()}
    better = min(percent["default"], percent["paper"])
    dense = 36 * 22**2
    told = {"percent": {k: round(v, 3) for k, v in percent.items()}}
    told |= {"joints": _rounded(np.sqrt(miss["sparse"] / miss["default"]))}
    entry = figure(percent["sparse"] / better, _WORSE, len(held), **told)
    if percent["default"] > _BEATS * percent["none"]:
        entry |= {"ok": None, "why": "the default form does not beat none by a fifth"}
    share = max(cells["sparse"]) / dense
    return {keys[0]: entry, keys[1]: figure(share, _SHARE, len(held), **cells)}


def _cells(lookup: Lookup) -> int:
    """Table cells that say something, of all joints together."""
    return sum(int((t.values != 0).any(axis=-1).sum()) for t in lookup.tables)


def _chosen_over_best(seed: int) -> float:
    """Error of the chosen levels on new runs over the least that any would leave."""
    X, Y, run = (part[::4] for part in repeated_rows(seed))
    new, truth, _ = (part[::4] for part in repeated_rows(seed + 1000))
    form = NominalForm(components=_COMPONENTS)
    chosen = choose_levels(X, Y, run, Y, form)
    own = _errors(X, Y, (new, truth), chosen.form)[chosen.components]
    every = [min(_errors(X, Y, (new, truth), replace(form, levels=k))) for k in SWEEP]
    return own / min(every)


def _errors(X: Array, Y: Array, new: tuple, form: NominalForm) -> list[float]:
    """Errors on new rows of 0 to A components."""
    model = fill_unvisited(fit_nominal_pls(X, Y, form))
    counts = range(model.components + 1)
    return [float(np.linalg.norm(new[1] - model.predict(new[0], a))) for a in counts]


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(float(v), 4) for v in values]
