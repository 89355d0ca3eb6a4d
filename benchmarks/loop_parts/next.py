"""Design one experiment after an open verdict, run it, and diagnose all logs.

An arm in the physics engine hides one effect; its first log is short and moves little.
Cases are arms whose verdict names a class that some motion can separate. A random and a
D-optimal Fourier motion within the same limits are run on the same arm. Along each log
the log Bayes factor between the truth and its nearest rival is computed, the first log
included, and compared at the end with what the design promised.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from benchmarks.harness.cases import guarded, seed_range
from benchmarks.harness.figures import FULL, NO_BAR, Figures, all_missing, figure, undecided
from benchmarks.harness.logs import in_engine
from benchmarks.harness.rates import at_least, rate
from flows.specs import derive_seed
from flows.steps.next import Ranking, rank_motions
from residual.diagnosis.diagnose import diagnose
from residual.effects import number_reported_joints
from residual.planning.next_experiment import (
    OpenQuestion,
    Pair,
    RivalUpdate,
    all_torque_columns,
    find_inseparable_pairs,
    predict_best_motion,
    rival_log_evidence,
)
from residual.recording import Array, Recording
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import Robot, load_robot
from residual.signals.track import build_tracks
from residual.verdict.result import Diagnosis, Place
from sim.engine.geometry import MARGIN, build_arm_capsules, compute_clearances
from sim.engine.plant_records import PlantEffect, PlantSpec, TrajectorySpec, create_random_stream
from sim.plant.typical_sizes import draw_plant_effect, list_drawable_effects
from sim.trajectories import plan_reference_motion
from sim.trajectories.excitation import (
    draw_feasible_series,
    export_series_coefficients,
    scale_series,
)
from sim.trajectories.planning_limits import build_workspace

GROUPS = ("next",)
SECONDS = 20.0  # of an experiment
DESIGNED, RANDOM, D_OPTIMAL = "designed", "random", "d_optimal"
BARS = {
    "next_settled": 0.80,
    "next_random_over_designed": 2.5,
    "next_d_optimal_over_designed": 1.5,
    "next_nats_within_two": 0.80,
    "next_beyond_limits": 0,
}


def jobs(args: argparse.Namespace) -> dict[str, int]:
    """Return the seeds; a case takes minutes, and a quick run has none."""
    seeds = () if args.quick else seed_range(args.seeds)
    return {f"next {seed}": seed for seed in seeds}


def all_figures(rows: Sequence[Mapping], args: argparse.Namespace) -> Figures:
    if args.quick:
        return all_missing(BARS, FULL)
    done = [r for r in rows if r.get("open")]
    reached = [r for r in done if r["reached"] is not None]
    timed = [r for r in done if r["in_time"] is not None]
    chances = [r["chance"] for r in done]
    chance = float(np.mean(chances)) if done else None
    figures = {
        "next_settled": rate(r["settled"] for r in done),
        "next_random_over_designed": _ratio(done, RANDOM),
        "next_d_optimal_over_designed": _ratio(done, D_OPTIMAL),
        "next_nats_within_two": rate(
            0.5 <= r["reached"] / r["expected_nats"] <= 2.0 for r in reached
        ),
    }
    figures = {key: at_least(entry, BARS[key]) for key, entry in figures.items()}
    figures |= {
        "next_beyond_limits": figure(sum(not r["kept"] for r in done), 0, len(done)),
        "next_sure_in_time": at_least(rate(r["in_time"] for r in timed), None),
        "next_chance_said": figure(chance, None, len(done), why=NO_BAR),
        "next_crashes": figure(sum("error" in r for r in rows), 0, len(rows)),
    }
    return figures if args.deciding else undecided(figures)


def _ratio(rows: Sequence[Mapping], name: str) -> dict:
    """Median seconds of a peer's motion over those of the designed one.

    A motion that never has enough counts with its length: the ratio is a lower bound.
    """
    times = [r["seconds"] for r in rows if r["seconds"][DESIGNED] is not None]
    if not times:
        return figure(None, None, 0, why="no case whose truth is a rival")
    designed, peer = (float(np.median([s[k] for s in times])) for k in (DESIGNED, name))
    never = sum(s[name] >= SECONDS for s in times)
    return figure(peer / designed, None, len(times), medians=[designed, peer], never=never)


FIRST = 10.0  # s, of the first log
POOR = 0.25  # of the size that the limits allow: how far the first log moves the arm
ENOUGH = 6.0  # nats
_LATER = 60.0  # s from the beginning of the first log to the experiment
_TRIES = 30  # arms drawn until the verdict of one is open
_STEP = 0.1  # s
_FINE = 2000.0  # Hz, finer than the checks that a motion is planned with


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """An arm whose first verdict is open."""

    plant: PlantSpec
    effect: PlantEffect
    logs: tuple[Recording, Recording]  # first and held out
    question: OpenQuestion
    twins: frozenset[Pair]  # of it, which no motion tells apart


def summary(row: Mapping) -> str:
    if not row["open"]:
        return "no arm with an open verdict"
    result = "settled" if row["settled"] else "not settled"
    times = ", ".join(f"{k} {s:.1f} s" for k, s in row["seconds"].items() if s)
    return f"{row['effect']} {row['joints']} {result}; {times}"


def run(seed: int) -> dict:
    """Draw an arm whose first verdict is open, and settle it; a row, or the crash."""
    return guarded({"seed": seed}, lambda: _row(seed))


def _row(seed: int) -> dict:
    case = _drawn(seed)
    if case is None:
        return {"seed": seed, "open": False}
    truth = Place(
        case.effect.name,
        tuple(number_reported_joints(case.effect.name, case.effect.joints, _robot().dof)),
    )
    ranking = rank_motions(case.question, _robot(), SECONDS, seed)
    assert ranking is not None
    logs = {k: _log(case.plant, m, _LATER) for k, m in _motions(ranking, seed).items()}
    after = diagnose(_robot(), (case.logs[0], logs[DESIGNED]), held_out=case.logs[1:])
    leads = {name: _leads(case, truth, log) for name, log in logs.items()}
    seconds = {name: _seconds(lead) for name, lead in leads.items()}
    ours, best = leads[DESIGNED], ranking.best
    edge = case.question.signals.edge
    return {
        "seed": seed,
        "open": True,
        "effect": truth.name,
        "joints": list(truth.joints),
        "settled": _settled(after, truth, case),
        "expected_nats": best.prospect.nats,
        "reached": None if ours is None else ours[-1],
        "chance": best.prospect.chance,
        "sure_after": best.after,
        "in_time": None
        if ours is None or best.after is None
        else seconds[DESIGNED] + edge <= best.after + _STEP,
        "family": best.spec.kind,
        "kept": _kept(best.spec),
        "seconds": seconds,
    }


def _motions(ranking: Ranking, seed: int) -> dict[str, TrajectorySpec]:
    chance, best = create_random_stream(seed, "random"), derive_seed(seed, "d")
    return {
        DESIGNED: ranking.best.spec,
        RANDOM: _fourier(chance, SECONDS, 1.0),
        D_OPTIMAL: TrajectorySpec("fourier", SECONDS, 2, best),
    }


def _kept(spec: TrajectorySpec) -> bool:
    robot = _robot()
    made = plan_reference_motion(robot, spec, _FINE)
    torque = compute_inverse_dynamics(robot.model, made.q, made.qd, made.qdd)
    return bool(
        (made.q >= robot.lower).all()
        and (made.q <= robot.upper).all()
        and (np.abs(made.qd) <= robot.velocity_limit).all()
        and (np.abs(torque) <= robot.torque_limit).all()
        and compute_clearances(build_arm_capsules(robot.model), made.q[::10]).min() >= MARGIN
    )


def _drawn(seed: int) -> Case | None:
    robot = _robot()
    for number in range(_TRIES):
        rng = create_random_stream(derive_seed(seed, f"arm/{number}"), "hidden")
        name = str(rng.choice(list_drawable_effects()))
        effect = draw_plant_effect(robot, rng, name)
        plant = PlantSpec(effects=(effect,), seed=derive_seed(seed, f"plant/{number}"))
        specs = [_fourier(rng, FIRST, POOR) for _ in range(2)]
        logs = tuple(_log(plant, s, 30.0 * i) for i, s in enumerate(specs))
        first = diagnose(robot, logs[:1], held_out=logs[1:])
        question = first.question
        if first.effects and question.contests and predict_best_motion(question):
            return Case(plant, effect, logs, question, find_inseparable_pairs(question))
    return None


def _settled(after: Diagnosis, truth: Place, case: Case) -> bool:
    """Whether the truth is named, beside nothing that some motion can tell from it."""
    known = _alike(case, truth)
    return any({Place(f.name, f.joints), *f.equivalent} <= known for f in after.effects)


def _alike(case: Case, truth: Place) -> set[Place]:
    """The truth and the rivals that no motion tells from it."""
    rivals = [[r.place for r in contest.rivals] for contest in case.question.contests]
    return {truth, *(rivals[c][b] for c, a, b in case.twins if rivals[c][a] == truth)}


def _leads(case: Case, truth: Place, log: Recording) -> list[float] | None:
    """By how much the truth leads the nearest, every `_STEP` [nats].

    None where the truth is no rival.
    """
    question, pairs = case.question, _pairs(case, truth)
    if not pairs:
        return None
    until = np.arange(_STEP, SECONDS + _STEP / 2, _STEP)

    def lead(pair: Pair, gram: Array, products: Array) -> float:
        """Before the log, and what the log did bring."""
        contest, both = question.contests[pair[0]], pair[1:]
        updates = [RivalUpdate.of(contest.rivals[i], gram) for i in both]
        a, b = (rival_log_evidence(products[:, None], gram, update)[0] for update in updates)
        return contest.lead(*both) + float(a - b)

    logged = logged_products(question, log, until)
    return [min(lead(pair, *products) for pair in pairs) for products in logged]


def logged_products(
    question: OpenQuestion, recording: Recording, until: Sequence[float]
) -> list[tuple[Array, Array]]:
    """Return X' X and X' y of a log up to some times from its first sample, whitened.

    Rows are filtered and left out as in a diagnosis.

    Args:
        until: Times [s].
    """
    floor, model = question.signals.speed_floor, question.nominal
    (track,), _ = build_tracks([recording], model.filters, floor)
    state = question.seen_with.observe(track)
    columns = track.filter(all_torque_columns(question, state))
    y = track.tau - track.filter(model.torque_on(track))
    root = np.sqrt(question.signals.information * track.moving)
    t = track.t[:: track.step] - track.t[0]
    out = []
    for end in until:
        rows = t < end
        x = (root[rows, :, None] * columns[rows]).reshape(-1, columns.shape[2])
        out.append((x.T @ x, x.T @ (root[rows] * y[rows]).ravel()))
    return out


def _seconds(leads: list[float] | None) -> float | None:
    """After how long the truth leads by enough; the length where it never does."""
    if leads is None:
        return None
    enough = np.flatnonzero(np.array(leads) >= ENOUGH)
    return float(_STEP * (1 + enough[0])) if len(enough) else SECONDS


def _pairs(case: Case, truth: Place) -> list[Pair]:
    """Pairs of the truth, or of its twin, and a rival that can be told from it.

    Those that the first log has told apart already are left out.
    """
    names = _alike(case, truth)
    return [
        (c, a, b)
        for c, contest in enumerate(case.question.contests)
        for a, b in contest.pairs
        if contest.rivals[a].place in names
        and contest.rivals[b].place not in names
        and (c, a, b) not in case.twins
        and contest.rivals[a].nats - contest.rivals[b].nats < ENOUGH
    ]


def _fourier(rng: np.random.Generator, seconds: float, size: float) -> TrajectorySpec:
    """Return a random Fourier motion of a share of the size that the limits allow."""
    space = build_workspace(_robot(), seconds / 2)
    series = scale_series(draw_feasible_series(space, rng), size)
    return TrajectorySpec("fourier", seconds, 2, 0, export_series_coefficients(series))


def _log(plant: PlantSpec, spec: TrajectorySpec, start: float) -> Recording:
    log = in_engine(_robot(), plant, spec, start)
    t = start + log.t - log.t[0]
    return Recording(f"{spec.kind}_{start:g}", log.robot, t, log.q, log.tau)


@lru_cache(maxsize=1)
def _robot() -> Robot:
    return load_robot("irb140")
