"""Arms driven by their nominal model, the augmented one and the true one.

On motions of families that no fit has seen; torque fed forward, with the same plain
feedback for all, as `modelgap validate` does it. One number per arm and family: root
mean square of read minus wanted position over all joints and motions. Beside it wrong
corrections (another sign, another joint, twice as much): whether the gate passes them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.harness.figures import Figures, figure
from benchmarks.synthetic.truth import truth_of
from residual.diagnosis.diagnose import diagnose
from residual.diagnosis.held_out import worth
from residual.diagnosis.result import Diagnosis
from residual.effects import vocabulary
from residual.model.control import feed_forward
from residual.model.model import Model, Term
from residual.robot.robot import Robot, load_robot
from sim.draw import draw_hidden
from sim.engine.records import PlantRun, PlantSpec, Reference, TrajectorySpec, stream
from sim.experiment import run_experiment
from sim.trajectories import make_reference
from sim.twin import track

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


def figures_of(quick: bool) -> Figures:
    """Return the figures of the group."""
    robot = load_robot("irb140", vocabulary())
    rows, cases = [], []
    for i, name in enumerate(QUICK if quick else EFFECTS):
        case = make_case(robot, name, SEED + i, LOGGED_QUICK if quick else LOGGED)
        cases.append(case)
        for kind in UNSEEN:
            rows.append(_row(case, kind, 2 if quick else MOTIONS))
            _tell(rows[-1])
    return _judged(rows, quick) | wrong_figures(cases)


def _row(case: Case, kind: str, count: int) -> dict:
    nominal, augmented = case.found.models["nominal"], case.found.known
    true = truth_of(case.robot, case.plant, nominal)
    missed = {"nominal": [], "augmented": [], "true": []}
    for seed in range(1000, 1000 + count):
        r = motion(case.robot, kind, seed, SECONDS)
        for own, model in zip(missed.values(), (nominal, augmented, true), strict=True):
            torque = feed_forward(model, r.t, (r.q, r.qd, r.qdd))
            error = track(case.robot, r, case.plant, torque)
            own.append((error**2).mean(axis=0).sum())
    rms = {name: float(np.sqrt(np.mean(each))) for name, each in missed.items()}
    names = [e.where for e in case.found.effects]
    return {"effect": case.name, "family": kind, "found": names, "rms": rms}


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
        "tracking_median_true": figure(float(np.median(true)), None, len(rows)),
    }
    if quick:
        why = "logs too short for it; the full run decides"
        figures["tracking_over_true"] |= {"ok": None, "why": why}
    return figures


def _gaining(rows: list, augmented: np.ndarray) -> Figures:
    """The worst ratio of those effects that gain most; no figure without them."""
    some = [row["effect"] in GAINING for row in rows]
    if not any(some):
        return {}
    worst = float(augmented[some].max())
    return {"tracking_gaining": figure(worst, GAINED, sum(some))}


def wrong_figures(cases: Sequence[Case]) -> Figures:
    """Count wrong corrections that pass the gate, and right ones that it refuses."""
    passed, tried, right = 0, 0, 0
    named = [case for case in cases if case.found.effects]
    for case in named:
        nominal, model = case.found.models["nominal"], case.found.known
        right += not worth(model, nominal, case.held_out).passed
        for how, wrong in _wrongs(model, nominal):
            through = worth(wrong, nominal, case.held_out).passed
            tried, passed = tried + 1, passed + through
            told = "passed" if through else "refused"
            print(f"{case.name:18} {how:6} {told}", flush=True)
    return {
        "wrong_corrections_adopted": figure(passed, 0, tried),
        "right_corrections_refused": figure(right, None, len(named)),
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
