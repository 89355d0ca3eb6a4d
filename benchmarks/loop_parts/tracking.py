"""Arms driven by their nominal model, the augmented one, the true one, and a table.

On motions of families that no fit has seen; torque fed forward, with the same plain
feedback for all. One number per arm and family: root mean square of read minus wanted
position over all joints and motions. Beside it wrong corrections: another sign, another
joint, twice as much; what comes of them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from benchmarks.harness.figures import Figures, all_missing, figure
from residual.calibration.calibrate import (
    Calibration,
    Settings,
    calibrate,
    corrected_model,
)
from residual.calibration.rows import Run
from residual.diagnosis.held_out import worth
from residual.diagnosis.result import Diagnosis
from residual.effects import registry, vocabulary
from residual.method.diagnose import diagnose
from residual.model.control import Use, computed_torque, feed_forward
from residual.model.corrected import Corrected
from residual.model.model import Model, Term
from residual.robot.dynamics import inertial_parameters
from residual.robot.robot import Robot, load_robot
from sim.draw import draw_hidden
from sim.engine.records import (
    PlantEffect,
    PlantRun,
    PlantSpec,
    Reference,
    TrajectorySpec,
    stream,
)
from sim.experiment import run_experiment
from sim.plant.arm import build_arm
from sim.plant.catalogue import acting, changed
from sim.trajectories import make_reference
from sim.twin import run_along

FIT = (*3 * ("fourier",), *3 * ("cyclic",))
HELD_OUT = ("cyclic", "fourier")
UNSEEN = ("welding", "move_stop_move")  # families of which no fit has seen a motion
PAUSE, RATE = 10.0, 1000.0


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """One arm with something to hide, diagnosed.

    Attributes:
        name: The hidden effect.
        robot: Its description.
        plant: What it is.
        runs: Its experiments, those to fit first.
        found: The diagnosis.
    """

    name: str
    robot: Robot
    plant: PlantSpec
    runs: tuple[PlantRun, ...]
    found: Diagnosis

    @property
    def held_out(self) -> list:
        """Logs that no fit has seen."""
        return [run.log for run in self.runs[len(FIT) :]]


def make_case(robot: Robot, name: str, seed: int, seconds: float) -> Case:
    """Draw an effect of a usual size, run experiments, and diagnose them.

    Args:
        seconds: Length of each experiment [s].
    """
    effect = draw_hidden(robot, stream(seed, f"loop/{name}"), name)
    plant = PlantSpec((effect,), seed=seed)
    runs = tuple(
        run_experiment(
            robot,
            motion(robot, kind, 100 * seed + i, seconds),
            plant,
            start=i * (seconds + PAUSE),
        )
        for i, kind in enumerate((*FIT, *HELD_OUT))
    )
    logs = [run.log for run in runs]
    found = diagnose(robot, logs[: len(FIT)], held_out=logs[len(FIT) :])
    return Case(name, robot, plant, runs, found)


def motion(robot: Robot, kind: str, seed: int, seconds: float) -> Reference:
    """Return a motion at the rate of the controller."""
    return make_reference(robot, TrajectorySpec(kind, seconds, 1, seed), RATE)


def true_model(case: Case) -> Model:
    """Return the model that knows everything of an arm."""
    robot, arm = case.robot, build_arm(case.robot, case.plant)
    body = inertial_parameters(changed(arm.model, acting(case.plant.effects)))
    drives = (
        ("viscous", arm.base.viscous),
        ("coulomb", arm.base.coulomb),
        ("rotor_inertia", arm.base.rotor),
    )
    terms = [
        _term(robot, name, (joint,), [value])
        for name, values in drives
        for joint, value in enumerate(values)
    ]
    for effect in case.plant.effects:
        terms += _terms_of(robot, effect)
    return Model(robot, body, tuple(terms))


def _terms_of(robot: Robot, hidden: PlantEffect) -> list[Term]:
    effect = registry()[hidden.name]
    if effect.carries == "body":
        return []  # the body has it
    (known,) = acting([hidden])
    values = [float(known.p[key]) for key in effect.parameters]
    places = [(j - 1,) for j in hidden.joints] or [()]
    return [_term(robot, hidden.name, joints, values) for joints in places]


def _term(robot: Robot, name: str, joints: tuple, values: list[float]) -> Term:
    effect = registry()[name]
    theta, shape = effect.from_values(np.array(values), robot)
    return Term(effect, joints, tuple(shape), np.asarray(theta, dtype=float))


EFFECTS = (
    "stribeck",
    "quadratic_viscous",
    "coulomb_asymmetry",
    "viscous_asymmetry",
    "payload",
    "spring",
    "balancer",
    "base_tilt",
    "load_friction",
)
# Of which an arm gains most where its dry friction is fed forward along the reference.
GAINING = ("stribeck", "payload", "load_friction")
QUICK = ("spring",)
SEED, MOTIONS, SECONDS = 129101, 5, 5.0
LOGGED, LOGGED_QUICK = 20.0, 8.0  # s, of each experiment to fit
REACHED, HALF, NEAR, NO_HARM = 0.4, 0.5, 1.15, 1.02
GAINED = 0.35
_TABLES = {"table": "tracking_median_table", "tables": "tracking_median_tables"}

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
            ways["tables"] = _fed(calibrated(case))
        rows += [_row(case, kind, ways, 2 if quick else MOTIONS) for kind in UNSEEN]
        wrongs.append((case, rows[-1]["references"]))
        for row in rows[-len(UNSEEN) :]:
            _tell(row)
    return _judged(rows, quick) | wrong_figures(wrongs) | _time(case, rows[0])


def _calibrated(case: Case, paper: bool) -> Calibration:
    fitted = case.runs[: len(FIT)]
    runs = [Run(r.log, k, r.twin) for r, k in zip(fitted, FIT, strict=True)]
    return calibrate(case.robot, runs, Settings(paper, views=False, schemes=()))


def calibrated(case: Case) -> Corrected:
    """Return the tables of the default form on an identified model, of the same runs.

    Nothing is named: what drives is what `modelgap validate --calibration` drives by.
    """
    return corrected_model(_calibrated(case, paper=False))


def paper_table(case: Case, nominal: Torque) -> Torque:
    """Return the nominal model's torque with the paper's table, from the same runs."""
    made = _calibrated(case, paper=True)
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
    nominal, augmented = found.models["nominal"], found.known
    return {"nominal": nominal, "augmented": augmented, "true": true_model(case)}


def _fed(model) -> Torque:
    return lambda r: feed_forward(model, r.t, (r.q, r.qd, r.qdd), Use())


def _row(case: Case, kind: str, ways: Mapping[str, Torque], count: int) -> dict:
    seeds = range(1000, 1000 + count)
    references = [motion(case.robot, kind, seed, SECONDS) for seed in seeds]
    done = {
        name: [run_along(case.robot, r, case.plant, way(r)) for r in references]
        for name, way in ways.items()
    }
    rms = {
        name: float(np.sqrt(np.mean([(one.rms**2).sum() for one in each])))
        for name, each in done.items()
    }
    names = [e.where for e in case.found.effects]
    about = {"effect": case.name, "family": kind, "found": names}
    step = max(float(one.step.max()) for one in done["augmented"])
    return {**about, "rms": rms, "step": step, "references": references}


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
        "tracking_median_over_true": figure(
            float(np.median(augmented / true)), None, len(rows)
        ),
        "tracking_over_nominal": figure(float(augmented.max()), NO_HARM, len(rows)),
        "tracking_median_augmented": figure(
            float(np.median(augmented)), HALF, len(rows)
        ),
        **_gaining(rows, augmented),
        "tracking_reversal_step": figure(
            max(row["step"] for row in rows), None, len(rows)
        ),
        "tracking_median_true": figure(float(np.median(true)), None, len(rows)),
    }
    if quick:
        why = "logs too short for it; the full run decides"
        figures["tracking_over_true"] |= {"ok": None, "why": why}
        why = "the full run fits the tables"
        return figures | all_missing(dict.fromkeys(_TABLES.values()), why)
    return figures | {
        name: figure(float(np.median(ratio[way])), None, len(rows))
        for way, name in _TABLES.items()
    }


def _gaining(rows: list, augmented: np.ndarray) -> Figures:
    """The worst ratio of those effects that gain most; no figure without them."""
    some = [row["effect"] in GAINING for row in rows]
    if not any(some):
        return {}
    worst = float(augmented[some].max())
    return {"tracking_gaining": figure(worst, GAINED, sum(some))}


def _time(case: Case, row: Mapping) -> Figures:
    """A step of computed torque by the augmented model, of the time that it has."""
    reference = row["references"][0]
    parts = reference.q, reference.qd, reference.qdd
    begun = perf_counter()
    law = computed_torque(case.found.known, reference.t, parts, Use())
    for k in range(len(reference.t)):
        law(k, *(part[k] for part in parts))
    step = (perf_counter() - begun) / len(reference.t)
    return {"tracking_step_of_period": figure(step * RATE, 1.0, len(reference.t))}


def wrong_figures(cases: Sequence[tuple[Case, Sequence[Reference]]]) -> Figures:
    """Count wrong corrections that pass the gate, or track as well as right ones."""
    passed, as_good, tried, right = 0, 0, 0, 0
    for case, references in cases:
        nominal, model = case.found.models["nominal"], case.found.known
        if not case.found.effects:
            continue
        right += not worth(model, nominal, case.held_out).passed
        best = _missed_by(case, references[0], model)
        for how, wrong in _wrongs(model, nominal):
            tried += 1
            through = worth(wrong, nominal, case.held_out).passed
            missed = _missed_by(case, references[0], wrong)
            passed += through
            as_good += missed <= best
            told = "passed" if through else "refused"
            print(f"{case.name:18} {how:6} {told}, {missed / best:.2f} x", flush=True)
    found = sum(bool(case.found.effects) for case, _ in cases)
    return {
        "wrong_corrections_adopted": figure(passed, 0, tried),
        "wrong_corrections_as_good": figure(as_good, 0, tried),
        "right_corrections_refused": figure(right, None, found),
    }


def _wrongs(model: Model, before: Model) -> Iterator[tuple[str, Model]]:
    had = {(t.effect.name, t.joints) for t in before.terms}
    new = [t for t in model.terms if (t.effect.name, t.joints) not in had]
    yield "sign", _with_terms(model, {id(t): replace(t, theta=-t.theta) for t in new})
    yield (
        "twice",
        _with_terms(model, {id(t): replace(t, theta=2 * t.theta) for t in new}),
    )
    local = [t for t in new if t.effect.scope == "local"]
    if local:
        dof = model.robot.dof
        moved = {id(t): replace(t, joints=((t.joints[0] + 1) % dof,)) for t in local}
        yield "joint", _with_terms(model, moved)


def _with_terms(model: Model, other: dict[int, Term]) -> Model:
    return replace(model, terms=tuple(other.get(id(t), t) for t in model.terms))


def _missed_by(case: Case, reference: Reference, model: Model) -> float:
    """Error of all joints together on one motion [rad]."""
    motion = reference.q, reference.qd, reference.qdd
    torque = feed_forward(model, reference.t, motion, Use())
    done = run_along(case.robot, reference, case.plant, torque)
    return float(np.linalg.norm(done.rms))
