"""What every joint of a used arm has beside its model, as a nuisance of the search.

No friction has the curve of a textbook, no gear is round. What of it depends on the
state of its own joint is left to tables on that state (nominal levels, G2017 section
2.6.1), Gaussian, of a size that the joints have in common. They are not fitted: they
are a part of the covariance of the rows (generalised least squares; Kennedy & O'Hagan
2001 call it model discrepancy). So whatever a table may imitate counts for less in
every fit and every evidence, and costs no time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects import registry
from residual.effects._tables import STATES
from residual.evidence.design import Design
from residual.evidence.fit import Fit, autocorrelation_time
from residual.model.model import Model
from residual.model.term import Term
from residual.recording import Array

KNOTS = {"table_of_speed": 8, "table_of_position": 13, "table_of_load": 5}
SIZES = np.geomspace(0.001, 0.08, 20)  # rms of a table, as a share of torque rms
LEAST = 0.002  # of it: below, no arm is called used
WORTH = 10.0  # nats that tables must gain on a joint, as a name must
# Of the joints must need them, and so many: two may have reasons of their own.
HALF, FEW = 0.5, 3
BEYOND = 1.25  # times the common size: what one joint may have
FLAT = 1e-9


@dataclass(frozen=True, eq=False, slots=True)
class Background:
    """Tables of one joint, on the rows of its logs.

    Attributes:
        basis: Orthonormal directions of the tables. Shape (rows, d).
        shrink: What of each direction a row loses, 0 to 1. Shape (d,).
        size: Rms torque that a table is expected to have, as a share of torque rms.
        tables: The tables, with coefficients of zero.
        turn: Coefficients of all tables per unit along each direction. (k, d).
        own: Column numbers of the joint's terms that the tables were made free of.
        beside: Coefficients of these, then of what every drive has and the model has
            not, per coefficient of the tables. Shape (own + others, k).
        others: Those that the model has not, with coefficients of zero.
    """

    basis: Array
    shrink: Array
    size: float
    tables: tuple[Term, ...]
    turn: Array
    own: Array
    beside: Array
    others: tuple[Term, ...] = ()

    def whiten(self, values: Array) -> Array:
        """Return rows without what the tables account for. Shape as given."""
        along = self.basis.T @ values
        return values - self.basis @ (along.T * self.shrink).T

    def restore(self, values: Array) -> Array:
        """Return rows as they were before ``whiten``. Shape as given."""
        along = self.basis.T @ values
        return values + self.basis @ (along.T * (1 / (1 - self.shrink) - 1)).T

    def learnt(self, left: Array) -> tuple[tuple[Term, ...], Array]:
        """Return the tables as what a fit leaves has them.

        Args:
            left: What the fit leaves of whitened rows. Shape (rows,).

        Returns:
            The tables, and what the joint's own terms gain. Shape (own,).
        """
        # The posterior mean along a direction of strength s is s / (1 + s) of the
        # plain projection; of a whitened one, which is short by 1 / sqrt(1 + s).
        short = 1 - self.shrink
        theta = self.turn @ ((1 - short**2) / short * (self.basis.T @ left))
        freed = -self.beside @ theta
        parts = np.concatenate([theta, freed[len(self.own) :]])
        out, start = [], 0
        for term in (*self.tables, *self.others):
            stop = start + len(term.theta)
            out.append(replace(term, theta=parts[start:stop]))
            start = stop
        return tuple(out), freed[: len(self.own)]


def usual_background(design: Design) -> tuple[Background | None, ...]:
    """Look whether most joints have more than their model, and how much of it.

    A change of the arm's bodies is no reason: all of the nominal model is free here. A
    single effect is none either: it is on one joint. How much the joints have is told
    by their median, so that one of them with more stands out.

    Args:
        design: The nominal model's columns on the fit logs.

    Returns:
        Tables of each joint; empty where the arm is as its model says.
    """
    looked = [_look(design, j) for j in range(design.dof)]
    known = [one for one in looked if one is not None]
    needed = np.array([x.size for x in known if x.nats > WORTH and x.size > LEAST])
    if len(needed) < max(HALF * len(known), FEW):
        return ()
    most = BEYOND * float(np.median(needed))
    return tuple(one and one.of(min(one.size, most)) for one in looked)


def learnt_tables(
    design: Design, background: Sequence[Background | None], fitted: Fit
) -> tuple[tuple[Term, ...], Array]:
    """What the tables of all joints came out as, beside a fit.

    Args:
        design: The columns.
        background: Tables of each joint.
        fitted: A fit of the design.

    Returns:
        The tables, and what the nominal coefficients gain. Shape (p,).
    """
    tables, gained = [], np.zeros(len(design.nominal))
    for j, one in enumerate(background):
        if one is not None:
            left = design.residual(j, fitted.ids, fitted.theta)
            terms, own = one.learnt(left)
            tables += terms
            gained[one.own] += own
    return tuple(tables), gained


def with_tables(model: Model, learnt: tuple[tuple[Term, ...], Array]) -> Model:
    """A model with tables beside those that it has, as `learnt_tables` gives them."""
    tables, gained = learnt
    if not tables:
        return model
    values = model.coefficients()
    values[: len(gained)] += gained
    return replace(model.with_coefficients(values), tables=(*model.tables, *tables))


@dataclass(frozen=True, eq=False, slots=True)
class _Look:
    """One joint's tables, how much of them is there, and how sure that is."""

    made: Background
    strength: Array
    size: float
    nats: float

    def of(self, size: float) -> Background:
        """Tables of that size."""
        shrink = 1 - (1 + size**2 * self.strength) ** -0.5
        return replace(self.made, shrink=shrink, size=size)


def _look(design: Design, j: int) -> _Look | None:
    """Evidence for tables on one joint, what every drive has being free there."""
    place, have = design.present(j, design.nominal)
    y = design.target[j]
    if len(y) < 5 * sum(KNOTS.values()):
        return None
    own = have[~np.isin(design.nominal[have], design.inertial)]
    others, lacking = _lacking(design, j)
    friction = np.hstack(
        [design.columns(j, design.place[j][design.nominal[own]]), lacking]
    )
    terms, columns, beside = _tables(design, j, friction)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    real = values > FLAT * values.max(initial=0.0)
    values, turn = values[real], vectors[:, real] / np.sqrt(values[real])
    basis = columns @ turn
    # A torque that never changes is no proof of tables, though they may have some.
    level = design.on_rows([np.ones((len(s.t), 1)) for s in design.states], j)
    free = _orthonormal(np.hstack([design.columns(j, place), lacking, level]))
    left = y - free @ (free.T @ y)
    inner = (basis - free @ (free.T @ basis)) * np.sqrt(values)
    size, nats, weight = _size(design, j, inner, left)
    kept = turn[: beside.shape[1]]  # what only these logs have, no model keeps
    nothing = np.zeros(len(values))
    made = Background(basis, nothing, size, terms, kept, own, beside, others)
    return _Look(made, design.rms[j] ** 2 * weight * values, size, nats)


def _lacking(design: Design, j: int) -> tuple[tuple[Term, ...], Array]:
    """What every drive has and the model has not on a joint, with its columns."""
    has = {t.effect.name for t in design.model.terms if t.joints == (j,)}
    usual = [e for e in registry().values() if e.usual_in_every_drive]
    wanted = [e for e in usual if e.name not in has]
    columns = [
        design.on_rows([e.columns(s, (j,), ())[:, 0] for s in design.states], j)
        for e in wanted
    ]
    terms = tuple(
        Term(e, (j,), (), np.zeros(c.shape[1]))
        for e, c in zip(wanted, columns, strict=True)
    )
    return terms, np.hstack([np.zeros((len(design.target[j]), 0)), *columns])


def _size(design: Design, j: int, tables: Array, left: Array):
    """Size of tables with the most evidence, the evidence, and the rows' weight."""
    strength, vectors = np.linalg.eigh(tables.T @ tables)
    strength = np.maximum(strength, FLAT * strength.max(initial=FLAT))
    pull = vectors.T @ (tables.T @ left)
    rest = left - tables @ (vectors @ (pull / strength))
    slow = autocorrelation_time(design.line(j, rest))
    noise = max(float(rest @ rest) / len(rest), FLAT * design.rms[j] ** 2)
    weight, counted = 1 / slow / noise, len(rest) / slow
    gains = []
    for size in (0.0, *SIZES):
        ratio = (size * design.rms[j]) ** 2 * weight
        sse = left @ left - (ratio * pull**2 / (1 + ratio * strength)).sum()
        fit = -0.5 * counted * np.log(sse / len(left))
        gains.append(fit - 0.5 * np.log1p(ratio * strength).sum())
    best = int(np.argmax(gains))
    return ((0.0, *SIZES)[best], float(gains[best] - gains[0]), weight)


def _tables(design: Design, j: int, friction: Array):
    """Tables of one joint and their columns, free of what every drive has.

    Friction that warms up is another table in each log; that one no model keeps.
    """
    states, terms, columns = design.states, [], []
    seen = {
        "table_of_speed": np.abs(np.concatenate([s.qd[:, j] for s in states])),
        "table_of_position": np.concatenate([s.q[:, j] for s in states]),
        "table_of_load": np.concatenate([s.rigid[:, j] for s in states]),
    }
    for effect in STATES:
        share = np.linspace(0.005, 0.995, KNOTS[effect.name])
        knots = np.unique(np.quantile(seen[effect.name], share))
        if len(knots) > 2:
            made = [effect.columns(s, (j,), tuple(knots))[:, 0] for s in states]
            columns.append(design.on_rows(made, j))
            shape = tuple(float(x) for x in knots)
            terms.append(Term(effect, (j,), shape, np.zeros(columns[-1].shape[1])))
    columns = np.hstack(columns)
    beside = np.linalg.lstsq(friction, columns, rcond=None)[0]
    warm = [
        s.sign[:, [j]] * (np.arange(len(states)) == k) for k, s in enumerate(states)
    ]
    warm = design.on_rows(warm, j)
    warm = warm - friction @ np.linalg.lstsq(friction, warm, rcond=None)[0]
    return tuple(terms), np.hstack([columns - friction @ beside, warm]), beside


def _orthonormal(columns: Array) -> Array:
    """An orthonormal basis of the span of some columns. Shape (rows, rank)."""
    size = np.linalg.norm(columns, axis=0)
    kept = columns[:, size > 0] / size[size > 0]
    values, vectors = np.linalg.eigh(kept.T @ kept)
    real = values > FLAT * values.max(initial=0.0)
    return kept @ (vectors[:, real] / np.sqrt(values[real]))
