"""Logs of real arms, where nobody knows the truth: what must hold all the same.

Half of a log says what the other half says; nothing that is named makes the held-out
error larger; nothing is named where the torque is a model's own plus noise.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.harness.figures import Figures, figure, missing
from benchmarks.harness.rates import wilson
from benchmarks.hidden.score import Name, Said, members
from benchmarks.measured_parts import arms
from residual.diagnosis.diagnose import diagnose
from residual.diagnosis.outcome import examine
from residual.evidence.fit import as_model
from residual.evidence.rules import EvidenceThresholds
from residual.model.compare import prepare_held_out
from residual.model.nominal import declared_names, prepare_logs, start_nominal
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.splitting import session_clock
from residual.signals.track import Filters, at_samples

WHITE, SHUFFLED = "white", "shuffled"
FIRST, SECOND, WHOLE = "first half", "second half", "whole"
KINDS = (FIRST, SECOND, WHOLE, WHITE, SHUFFLED)
_SEED = 7  # of the noise only; the logs are what they are


def jobs(quick: bool) -> list[tuple[str, str]]:
    """Return what to diagnose; nothing where the logs are not there."""
    if arms.data_folder() is None or quick:
        return []
    return [(arm, kind) for arm in (arms.KR300, arms.UR10) for kind in KINDS]


def run(job: tuple[str, str]) -> dict:
    """Diagnose one arm's logs: a half, the whole, or with the residual replaced."""
    arm, kind = job
    robot, fit, held_out = _logs(arm, kind)
    if kind in (WHITE, SHUFFLED):
        fit, held_out = _without_structure(robot, fit, held_out, kind)
    verdict = diagnose(robot, fit, (), held_out).verdict
    return {
        "arm": arm,
        "kind": kind,
        "said": [
            [s.name.effect, s.name.joints, [[a.effect, a.joints] for a in s.alike]]
            for s in members(verdict)
        ],
        "gains": [e.evidence.held_out_gain for e in verdict.effects],
        "overall": verdict.error.overall_filtered,
        "filtered": verdict.error.filtered,
        "unexplained": list(verdict.unexplained.joints),
        "warnings": list(verdict.warnings),
    }


def measured_figures(results: Sequence[dict]) -> Figures:
    """Return stability, harm and names in noise; null where the logs are absent."""
    names = (
        "measured_halves_contradict",
        "measured_names_that_harm",
        "measured_named_in_noise",
    )
    if not results:
        why = "no measured logs here, or a quick run"
        return {name: missing(0, why) for name in names}
    against, common, every = 0, 0, 0
    for arm in (arms.KR300, arms.UR10):
        one, other = (_said(results, arm, half) for half in (FIRST, SECOND))
        for mine, theirs in ((one, other), (other, one)):
            every += len(mine)
            common += sum(_repeated(s, theirs) for s in mine)
            against += sum(_contradicted(s, theirs) for s in mine)
    real = [r for r in results if r["kind"] in (FIRST, SECOND, WHOLE)]
    gains = [g for r in real for g in r["gains"]]
    noise = [r for r in results if r["kind"] in (WHITE, SHUFFLED)]
    worse = [
        f"{r['arm']} {r['kind']}"
        for r in real
        if r["overall"]["augmented"] > r["overall"]["identified"]
    ]
    share = common / every if every else None
    return {
        names[0]: figure(against, 0, every),
        "measured_halves_repeat": figure(share, None, every, why="for information")
        | {"interval": wilson(common, every)},
        names[1]: figure(sum(g < 0 for g in gains), 0, len(gains)),
        "measured_worse_than_refit": figure(len(worse), 0, len(real), which=worse),
        names[2]: figure(sum(len(r["said"]) for r in noise), 0, len(noise)),
    }


def _logs(arm: str, kind: str):
    if arm == arms.KR300:
        half = {FIRST: "@:50%", SECOND: "@50%:"}.get(kind, "")
        fit, held_out = [f"run_{x}.csv{half}" for x in "AB"], ["run_C.csv"]
    else:
        part = {FIRST: ":30%", SECOND: "30%:60%"}.get(kind, ":60%")
        fit, held_out = [f"run.csv@{part}"], ["run.csv@60%:"]
    return arms.robot_of(arm), arms.read_logs(arm, fit), arms.read_logs(arm, held_out)


def _without_structure(
    robot: Robot, fit: Sequence[Recording], held_out: Sequence[Recording], kind: str
):
    """Return the same motions with the torque of a fitted model and a plain residual.

    The model has nothing but what the robot declares; the residual is white noise of
    its size, or itself with its samples in random order.
    """
    filters = Filters()
    logs = prepare_logs(robot, fit, session_clock([*fit, *held_out]), filters)
    nominal = start_nominal(logs, declared_names(robot, None))
    found = examine(logs, nominal, EvidenceThresholds(), lambda stage, share: None)
    # Without the standstill that suits these logs: as an extra shape of friction it
    # would be something to find.
    model = as_model(found.nominal, found.plain)
    rng, out = np.random.default_rng(_SEED), []
    for recording in (*fit, *held_out):
        (witness,) = prepare_held_out([recording], model)
        torque = model.torque_on(witness.track)
        tau_hat = at_samples(torque, witness.track, recording)
        left = recording.tau - tau_hat
        left -= left.mean(axis=0)  # in any order a mean stays an offset
        noise = rng.permutation(left, axis=0)
        if kind == WHITE:
            noise = left.std(axis=0) * rng.normal(size=left.shape)
        out.append(replace(recording, tau=tau_hat + noise))
    return out[: len(fit)], out[len(fit) :]


def _said(results: Sequence[dict], arm: str, kind: str) -> list[Said]:
    def name(one: Sequence) -> Name:
        return Name(one[0], tuple(one[1]))

    found = next(r for r in results if (r["arm"], r["kind"]) == (arm, kind))
    return [
        Said(name(one), tuple(map(name, alike)), {}) for *one, alike in found["said"]
    ]


def _repeated(one: Said, others: Sequence[Said]) -> bool:
    """Whether another half says the same, by name or by class."""
    mine = {one.name, *one.alike}
    return any(mine & {other.name, *other.alike} for other in others)


def _contradicted(one: Said, others: Sequence[Said]) -> bool:
    """Whether another half blames something else for what is on the same joints."""
    there = [o for o in others if set(o.name.joints) == set(one.name.joints)]
    return bool(there) and not _repeated(one, others)
