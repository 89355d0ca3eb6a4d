"""Diagnoses of random columns, whose answers can be computed with numpy."""

from dataclasses import dataclass

import numpy as np

from residual.diagnosis.candidates import Candidates
from residual.diagnosis.score import Score
from residual.diagnosis.search import Search
from residual.effects.base import Effect, EffectTrait, State, build_joint_columns
from residual.evidence.columns import merge_groups
from residual.evidence.design import CandidateColumns, Design
from residual.evidence.fit import NominalPrior
from residual.model.model import Model
from residual.signals.track import Track
from tests.residual.arms import arm

DOF, NOMINAL = 2, 20


def _everywhere(state, joints, shape):
    return np.stack([state.qdd, np.roll(state.qdd, 1, axis=1), state.q * state.qd], 2)


def _pair(state, joints, shape):
    a, b = joints
    drag = np.stack([state.qd[:, a] + state.qd[:, b], state.q[:, a]], axis=1)
    return np.stack([drag, -drag], axis=1)


LINE = Effect(
    "line",
    "a line",
    {"a": "1"},
    build_joint_columns(lambda s, j, x: [s.q[:, j]]),
    traits=EffectTrait.GROUPABLE,
)
OTHER = Effect(
    "other",
    "a line",
    {"a": "1"},
    build_joint_columns(lambda s, j, x: [s.qd[:, j]]),
    traits=EffectTrait.GROUPABLE,
)
PLANE = Effect(
    "plane",
    "two",
    {"a": "1", "b": "1"},
    build_joint_columns(lambda s, j, x: [s.qd[:, j], s.qdd[:, j]]),
)
GEAR = Effect("gear", "a pair", {"a": "1", "b": "1"}, _pair, scope="pair")
LOAD = Effect("load", "all rows", {k: "1" for k in "abc"}, _everywhere, scope="flange")
ALL = (LINE, OTHER, PLANE, GEAR, LOAD)


@dataclass
class Problem:
    """Random columns, torque made of them, and the design that the core builds."""

    logs: list
    design: Design
    prior: NominalPrior

    @classmethod
    def draw(cls, rng, truth=(), rows=120, logs=4, **options):
        """Draw logs of so many rows with (effect, joints, theta) of a truth in them.

        Options: ``noise`` (its size), ``colour`` (AR(1) coefficient of noise),
        ``masked`` (share of rows that do not count), ``bend`` (size of the nominal
        coefficients in units of their prior), ``slow`` (AR(1) of the columns).
        """
        noise, colour = options.get("noise", 1.0), options.get("colour", 0.0)
        prior = nominal_prior(rng)
        theta = options.get("bend", 1.0) * rng.normal(size=NOMINAL)
        theta = theta / np.sqrt(np.diag(prior.precision))
        tracks = []
        for k in range(logs):
            state = random_state(rng, rows, options.get("slow", 0.0))
            tau = state.regressor @ theta
            for effect, joints, own in truth:
                on = list(effect.rows(joints, DOF))
                tau[:, on] += effect.columns(state, joints, ()) @ np.asarray(own)
            tau += noise * coloured(rng, rows, colour)
            keep = rng.uniform(size=(rows, DOF)) >= options.get("masked", 0.0)
            tracks.append((track(tau, keep, f"log{k}", state), state))
        problem = cls(tracks, build(tracks), prior)
        problem.theta = theta
        return problem

    def stacked(self, members, logs=None):
        """All rows of all joints as one regression: X, y and the joint of each row."""
        x, y, joint = [], [], []
        for j in range(DOF):
            for k, (own, state) in enumerate(self.logs):
                if logs is not None and k not in logs:
                    continue
                use = own.moving[:, j]
                blocks = [state.regressor[:, j]]
                for group in members:
                    on = group.effect.rows(group.joints, DOF)
                    columns = group.effect.columns(state, group.joints, group.shape)
                    here = columns[:, on.index(j)] if j in on else 0 * columns[:, 0]
                    blocks.append(here)
                x.append(np.concatenate(blocks, axis=1)[use])
                y.append(own.tau[use, j])
                joint.append(np.full(int(use.sum()), j))
        return np.concatenate(x), np.concatenate(y), np.concatenate(joint)

    def precision(self, members):
        size = NOMINAL + sum(len(g.ids) for g in members)
        out = np.zeros((size, size))
        out[:NOMINAL, :NOMINAL] = self.prior.precision
        start = NOMINAL
        for g in members:
            stop = start + len(g.ids)
            out[start:stop, start:stop] = g.precision
            start = stop
        return out

    @property
    def score(self):
        return Score(self.design, self.prior)

    def search(self, groups, curves=()):
        price = {g.key: 1.0 for g in groups}
        return Search(self.score, Candidates(tuple(groups), price), curves)


def nominal_prior(rng) -> NominalPrior:
    mix = np.eye(NOMINAL) + 0.1 * rng.normal(size=(NOMINAL, NOMINAL))
    precision = 4.0 * mix @ mix.T
    return NominalPrior(precision, float(np.linalg.slogdet(precision)[1]), 0.03, {})


def random_state(rng, rows, slow=0.0) -> State:
    q, qd, qdd = (coloured(rng, rows, slow) for _ in range(3))
    regressor = rng.normal(size=(rows, DOF, NOMINAL))
    regressor[:, 1, : NOMINAL // 2] = 0.0  # no link loads a joint that it is before
    return State(
        robot=arm(),
        rate=1.0,
        t=np.arange(rows, dtype=float),
        q=q,
        qd=qd,
        qdd=qdd,
        sign=np.sign(qd),
        regressor=regressor,
        rigid=np.zeros((rows, DOF)),
        tau_model=np.zeros((rows, DOF)),
    )


def track(tau, keep, label, state) -> Track:
    """A track whose cut-off is beyond its rate: its filter is the identity."""
    return Track(
        id=label,
        rate=100.0,
        t=np.arange(len(tau), dtype=float),
        q=state.q,
        qd=state.qd,
        qdd=state.qdd,
        cutoff=100.0,
        step=1,
        tau=tau,
        valid=np.ones(len(tau), dtype=bool),
        moving=keep,
        torque_noise=np.zeros(DOF),
    )


BLOCK = 20  # rows


def build(logs) -> Design:
    """The design of the logs in blocks."""
    model, labels, start = Model(arm(), np.zeros(NOMINAL), (), np.ones(DOF)), [], 0
    for own, _ in logs:
        labels.append(start + np.arange(len(own.tau)) // BLOCK)
        start = labels[-1][-1] + 1
    return Design([t for t, _ in logs], model, [s for _, s in logs], labels=labels)


def coloured(rng, rows, a):
    out = rng.normal(size=(rows, DOF))
    out[1:] *= np.sqrt(1 - a**2)
    for i in range(1, rows):
        out[i] += a * out[i - 1]
    return out


def every_group(design) -> list[CandidateColumns]:
    """One candidate of each kind on each of its joints, and one on all joints."""
    groups = design.add([(e, js, ()) for e in ALL for js in e.candidates(DOF)])
    return [*groups, merge_groups(groups[:2])]
