"""Arms driven by their nominal model, the augmented one, the true one, and a table.

On motions of families that no fit has seen; torque fed forward, with the same plain
feedback for all. One number per arm and family: root mean square of read minus wanted
position over all joints and motions.
"""

from collections.abc import Callable, Mapping
from time import perf_counter

import numpy as np

from benchmarks.figures import Figures, figure, missing
from benchmarks.loop_parts.tracked_arms import (
    FIT,
    RATE,
    UNSEEN,
    Case,
    make_case,
    motion,
    true_model,
)
from benchmarks.loop_parts.wrong import wrong_figures
from residual.calibration.calibrate import Settings, calibrate
from residual.calibration.rows import Run
from residual.effects import vocabulary
from residual.model.control import Use, computed_torque, feed_forward
from residual.robot.robot import load_robot
from sim.records import Reference
from sim.twin import drive

EFFECTS = (
    "stribeck",
    "quadratic_viscous",
    "coulomb_asymmetry",
    "viscous_asymmetry",
    "payload",
    "spring",
    "balancer",
    "base_tilt",
)
QUICK = ("spring",)
SEED, MOTIONS, SECONDS = 17, 5, 5.0
LOGGED, LOGGED_QUICK = 20.0, 8.0  # s, of each experiment to fit
REACHED, HALF, NEAR, NO_HARM = 0.4, 0.5, 1.1, 1.02

Torque = Callable[[Reference], np.ndarray]


def figures_of(quick: bool) -> Figures:
    """Return the figures of the group."""
    robot = load_robot("irb140", vocabulary())
    rows, wrongs = [], []
    for i, name in enumerate(QUICK if quick else EFFECTS):
        logged = LOGGED_QUICK if quick else LOGGED
        case = make_case(robot, name, SEED + i, logged)
        ways = {k: _fed(m) for k, m in _models(case).items()}
        if not quick:
            ways["table"] = paper_table(case, ways["nominal"])
        rows += [_row(case, kind, ways, 2 if quick else MOTIONS) for kind in UNSEEN]
        wrongs.append((case, rows[-1]["references"]))
        for row in rows[-len(UNSEEN) :]:
            _tell(row)
    return _judged(rows, quick) | wrong_figures(wrongs) | _time(case, rows[0])


def paper_table(case: Case, nominal: Torque) -> Torque:
    """Return the nominal model's torque with the paper's table, from the same runs."""
    fitted = case.runs[: len(FIT)]
    runs = [Run(r.log, k, r.twin) for r, k in zip(fitted, FIT, strict=True)]
    settings = Settings(paper=True, views=False, schemes=())
    made = calibrate(case.robot, runs, settings)
    lookup, joints = made.paper, [joint - 1 for joint in made.rows.joints]

    def torque(reference: Reference) -> np.ndarray:
        out = nominal(reference).copy()
        out[:, joints] += lookup.predict(_states(reference, made.rows.names))
        return out

    return torque


def _states(reference: Reference, names: tuple[str, ...]) -> np.ndarray:
    """Variables of the paper's table along a reference. Shape (n, p)."""
    columns = []
    for name in names:
        on = name.rstrip("0123456789")
        columns.append(getattr(reference, on)[:, int(name[len(on) :]) - 1])
    return np.column_stack(columns)


def _models(case: Case) -> Mapping:
    found = case.found
    nominal, augmented = found.models["nominal"], found.known.model
    return {"nominal": nominal, "augmented": augmented, "true": true_model(case)}


def _fed(model) -> Torque:
    return lambda r: feed_forward(model, r.t, (r.q, r.qd, r.qdd), Use())


def _row(case: Case, kind: str, ways: Mapping[str, Torque], count: int) -> dict:
    seeds = range(1000, 1000 + count)
    references = [motion(case.robot, kind, seed, SECONDS) for seed in seeds]
    rms = {
        name: float(np.sqrt(np.mean([_missed(case, r, way(r)) for r in references])))
        for name, way in ways.items()
    }
    names = [e.where for e in case.found.effects]
    about = {"effect": case.name, "family": kind, "found": names}
    return {**about, "rms": rms, "references": references}


def _missed(case: Case, reference: Reference, torque: np.ndarray) -> float:
    """Squared error of all joints together [rad^2]."""
    done = drive(case.robot, reference, case.plant, torque)
    return float((done.rms**2).sum())


def _tell(row: Mapping) -> None:
    nominal = row["rms"]["nominal"]
    ratios = (f"{k} {v / nominal:.3f}" for k, v in row["rms"].items() if k != "nominal")
    print(
        f"{row['effect']:18} {row['family']:15} {1e3 * nominal:7.3f} mrad;",
        *ratios,
        f"found: {', '.join(row['found']) or 'nothing'}",
        flush=True,
    )


def _judged(rows: list, quick: bool) -> Figures:
    ratio = {
        name: np.array([row["rms"][name] / row["rms"]["nominal"] for row in rows])
        for name in rows[0]["rms"]
    }
    augmented, true = ratio["augmented"], ratio["true"]
    reached = true <= REACHED
    missed = int((augmented[reached] > HALF).sum())
    count = int(reached.sum())
    figures = {
        "tracking_not_halved": figure(missed if count else None, 0, count),
        "tracking_over_true": figure(float((augmented / true).max()), NEAR, len(rows)),
        "tracking_over_nominal": figure(float(augmented.max()), NO_HARM, len(rows)),
        "tracking_median_augmented": figure(
            float(np.median(augmented)), None, len(rows)
        ),
        "tracking_median_true": figure(float(np.median(true)), None, len(rows)),
    }
    if quick:
        why = "logs too short for it; the full run decides"
        figures["tracking_over_true"] |= {"ok": None, "why": why}
        why = "the full run fits the table"
        return figures | {"tracking_median_table": missing(None, why)}
    table = float(np.median(ratio["table"]))
    return figures | {"tracking_median_table": figure(table, None, len(rows))}


def _time(case: Case, row: Mapping) -> Figures:
    """A step of computed torque by the augmented model, of the time that it has."""
    reference = row["references"][0]
    parts = reference.q, reference.qd, reference.qdd
    begun = perf_counter()
    law = computed_torque(case.found.known.model, reference.t, parts, Use())
    for k in range(len(reference.t)):
        law(k, *(part[k] for part in parts))
    step = (perf_counter() - begun) / len(reference.t)
    return {"tracking_step_of_period": figure(step * RATE, 1.0, len(reference.t))}
