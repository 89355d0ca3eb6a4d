"""The first epoch of a watch: healthy runs fitted as one arm, and each joint by itself.

Rows of a stream are filtered already, so they are rows of the one design as they are.
What one arm has, and no model declares, is no change: it is fitted, and what of it is
not sure stays a direction in which rows may differ.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects import registry
from residual.effects.base import Span
from residual.epochs.joint import Joint
from residual.epochs.pursuit import chosen
from residual.epochs.rows import LOOSE, Layout, joint_fit
from residual.epochs.rules import Rules as EpochRules
from residual.errors import InputError
from residual.evidence.design import LAGS
from residual.evidence.states import as_model
from residual.model.model import Model
from residual.model.nominal import Logs, Nominal
from residual.model.term import Term
from residual.monitoring.rows import Rows
from residual.monitoring.rules import MONITOR
from residual.monitoring.stream.reference import Reference, columns_of
from residual.monitoring.stream.watch import usable
from residual.recording import Array
from residual.signals.track import Filters, Track

AT_ONCE = 2048  # rows: what their columns take stays under 100 MB


class _Seen(Track):
    """Rows of a stream, which are filtered already, as a track."""

    __slots__ = ()

    def filter(self, columns: Array) -> Array:
        return columns


def fitted(bare: Reference, runs: Sequence[Rows]) -> Model:
    """One arm fitted to all runs as an epoch is, with what any arm has a little of.

    And with what single joints of this one have of the vocabulary, by pursuit.
    """
    logs = _logs(bare, runs)
    nominal = Nominal(bare.model, (None,) * len(bare.model.terms))
    joint = joint_fit(logs, nominal, (LOOSE,))
    model, design = as_model(nominal, joint.fitted), joint.design
    design.show_torque(model)
    wanted = [
        (effect, on, shape)
        for effect in registry().values()
        if effect.scope == "local" and not (effect.remembers or effect.needs_clock)
        for on in effect.candidates(bare.dof)
        for shape in effect.shapes(logs.span, on[0])
    ]
    groups = design.add(wanted)
    usual = np.concatenate([design.nominal, *(g.ids for g in joint.known)])
    terms = []
    for j in range(bare.dof):
        shared = design.columns(j, design.present(j, usual)[0])
        rows = np.ones(len(shared), bool)
        target = design.residual(j, joint.fitted.ids, joint.fitted.theta)
        starts = np.zeros(1, int)
        layout = Layout(~rows, np.zeros(len(rows), int), starts, starts)
        alone = Joint(shared, target, layout, light=True)
        own = [g for g in groups if g.joints == (j,)]
        terms += chosen(design, j, own, rows, alone, EpochRules())
    more = [Term(g.effect, g.joints, g.shape, np.zeros(len(g.ids))) for g in terms]
    return replace(model, terms=(*model.terms, *more))


def _logs(bare: Reference, runs: Sequence[Rows]) -> Logs:
    """The runs as the logs of an epoch; of many rows some, evenly spread."""
    dof = bare.dof
    step = max(1, sum(len(r.t) for r in runs) // MONITOR.most_rows)
    rate = bare.window.row_rate / step
    tracks = []
    for i, whole in enumerate(runs):
        use, _ = usable(bare, bare.is_slow(whole), np.zeros(dof, int))
        rows, use = whole[::step], use[::step]
        tracks.append(
            _Seen(
                id=f"run {i}",
                rate=rate,
                t=np.arange(len(rows.t)) / rate,
                q=rows.q,
                qd=rows.qd,
                qdd=rows.qdd,
                cutoff=0.25 * bare.window.row_rate,
                step=1,
                tau=rows.tau,
                inner=np.ones(len(rows.t), bool),
                moving=use,
                torque_noise=np.zeros(dof),
            )
        )
    moving = np.sum([t.moving.sum(axis=0) for t in tracks], axis=0)
    if (moving < LAGS).any():
        raise InputError(
            f"Joint {int(moving.argmin()) + 1} hardly moves in the healthy runs. Give "
            "runs that move it."
        )
    every = Rows.joined(runs)
    span = Span(
        speed=np.quantile(np.abs(every.qd), 0.95, axis=0),
        travel=np.ptp(every.q, axis=0),
        duration=0.0,
        cutoff=0.25 * bare.window.row_rate,
        torque=np.quantile(np.abs(every.tau), 0.995, axis=0),
    )
    floor, robot = bare.model.speed_floor, bare.model.robot
    return Logs(robot, tuple(tracks), None, span, floor, Filters(), ())


@dataclass(frozen=True, eq=False, slots=True)
class Taught:
    """Normal equations of each run, joint by joint.

    Attributes:
        use: Where joints of each run count. Shapes (m, dof).
        gram: Products of the columns. Shape (runs, dof, p, p).
        cross: Those with what the fit of all leaves. Shape (runs, dof, p).
        power: Squares of that [N^2 m^2]. Shape (runs, dof).
        rows: Rows of each joint. Shape (runs, dof).
        torque: Squares of the torque on them. Shape (runs, dof).
        size: Squares of friction, its dry part and speed on them. (runs, dof, 3).
        free: Deviation of torque that a column may have [1]: of rms.
    """

    use: tuple[Array, ...]
    gram: Array
    cross: Array
    power: Array
    rows: Array
    torque: Array
    size: Array
    free: float

    @classmethod
    def of(cls, bare: Reference, runs: Sequence[Rows]) -> "Taught":
        """Add up the rows of each run."""
        sums, use = [], []
        for rows in runs:
            moves, _ = usable(bare, bare.is_slow(rows), np.zeros(bare.dof, int))
            use.append(moves)
            parts = [
                _normal(bare, rows[i : i + AT_ONCE], moves[i : i + AT_ONCE])
                for i in range(0, len(rows.t), AT_ONCE)
            ]
            sums.append([sum(own) for own in zip(*parts, strict=True)])
        every = [np.array(own) for own in zip(*sums, strict=True)]
        return cls(tuple(use), *every, free=bare.rules.free)

    @property
    def rms(self) -> Array:
        """Torque of each joint [N m]. Shape (dof,)."""
        rows = np.maximum(self.rows.sum(axis=0), 1.0)
        return np.maximum(np.sqrt(self.torque.sum(axis=0) / rows), 1e-9)

    def fit(self, without: int = -1) -> tuple[Array, Array, Array]:
        """Fit each joint to all runs but one.

        Returns:
            Coefficients beyond those of the model, shape (dof, p); their posterior
            covariance over the noise of independent rows, (dof, p, p); and the sizes
            of columns, (dof, p).
        """
        used = [i for i in range(len(self.gram)) if i != without]
        gram, cross = self.gram[used].sum(axis=0), self.cross[used].sum(axis=0)
        rows = np.maximum(self.rows[used].sum(axis=0), 1.0)[:, None]
        size = np.sqrt(np.einsum("jpp->jp", gram) / rows)
        size = np.maximum(size, 1e-9 * size.max())
        left = (
            self.power[used].sum(axis=0) / rows[:, 0] + (MONITOR.floor * self.rms) ** 2
        )
        held = left / (self.free * self.rms) ** 2
        inner = gram / (size[:, :, None] * size[:, None, :])
        inner = inner + held[:, None, None] * np.eye(gram.shape[-1])
        inverse = np.linalg.inv(inner)
        theta = (inverse @ (cross / size)[..., None])[..., 0] / size
        return theta, inverse, size

    def reference(self, bare: Reference) -> Reference:
        """What all runs teach, but for noise and limits.

        Directions are told by the torque that a column of each may have; those that no
        motion shows (bodies whose torques are one) are none.
        """
        theta, inverse, size = self.fit()
        rows = np.maximum(self.rows.sum(axis=0), 1.0)[:, None, None]
        outer = size[:, :, None] * size[:, None, :]
        values, vectors = np.linalg.eigh(self.gram.sum(axis=0) / outer / rows)
        real = (
            vectors
            * (values > MONITOR.real * values.max(axis=-1, keepdims=True))[:, None]
        )
        seen = real @ np.swapaxes(real, -1, -2)
        values, vectors = np.linalg.eigh(seen @ inverse @ seen)
        most = bare.rules.uncertain
        values, vectors = values[:, ::-1][:, :most], vectors[:, :, ::-1][:, :, :most]
        basis = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
        friction = np.sqrt(self.size.sum(axis=0) / rows[..., 0])
        return replace(
            bare, theta=theta, basis=basis / size[..., None], friction=friction
        )


def _normal(bare: Reference, rows: Rows, use: Array) -> tuple[Array, ...]:
    """Products of the columns of some rows, joint by joint."""
    made = columns_of(bare.model, rows)
    x = (made.x * use[..., None]).transpose(1, 0, 2)
    left = ((rows.tau - made.expected) * use).T
    braking = made.x @ (made.braking * made.base)
    size = np.stack([braking, made.sign, rows.qd], axis=-1) * use[..., None]
    return (
        np.swapaxes(x, 1, 2) @ x,
        (left[:, None] @ x)[:, 0],
        (left**2).sum(axis=1),
        use.sum(axis=0).astype(float),
        ((rows.tau * use) ** 2).sum(axis=0),
        (size**2).sum(axis=0),
    )
