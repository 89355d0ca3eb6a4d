"""Noise of the angles in the regressor: what it does to a fit, and the remedy.

Least squares takes the regressor for exact. It is made of measured angles, so it holds
their noise, and where a controller fed that noise back, so does the torque. A reference
knows nothing of either: columns made of it are instruments (two-stage least squares;
Janot, Vandanjon, Gautier 2014), and where both estimates differ by more than chance
least squares was biased (Durbin, Wu, Hausman; Janot et al. 2016). Without a reference
the noise is redrawn as it was measured and taken out of the normal equations; what that
moves is counted as doubt (effective variance).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.special import ndtri, stdtrit

from residual.diagnosis.examine import Examined
from residual.diagnosis.gate import Tested
from residual.diagnosis.held_out import Verdicts, without
from residual.diagnosis.search import refined
from residual.effects.base import Effect, Placed, Shape, Trait
from residual.evidence.design import Design, Group
from residual.evidence.fit import (
    Fit,
    Prior,
    System,
    as_model,
    chance_of,
    fit,
    physical,
    scaled_inverse,
)
from residual.evidence.priors import OF_NAMES, Space, first_design
from residual.evidence.rules import RULES
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.splitting import in_pieces
from residual.signals.track import on_rows_of, prepare

INSTRUMENTS, EFFECTIVE = "instruments", "effective variance"
FLAT = 1e-9  # of the largest singular value or correlation: what moves nothing
LEAST = 1e-3  # of its variance: what a difference is never known better than


@dataclass(frozen=True, eq=False, slots=True)
class Checked:
    """A fit, held against the noise of the angles."""

    how: str  # "instruments" or "effective variance"
    fit: Fit  # the fit that was checked
    # Coefficients by instruments; without them the fit's own, rid of what the noise
    # took, (m,).
    theta: Array
    covariance: Array  # of ``theta``, (m, m)
    spread: Array  # by how much it exceeds that of the fit, (m, m)
    # Part of each joint's residual variance that the angles' noise makes; NaN with
    # instruments, (dof,).
    share: Array

    def differs(self, tested: Tested) -> bool:
        """Whether the fit without the noise is another one, beyond chance."""
        shift, slots = self._shift(tested)
        return chance_of(shift, self._spread(slots), LEAST) < RULES.noise_chance

    def is_noise(self, tested: Tested) -> bool:
        """Whether the effect is made of the noise, or too much of it to believe.

        A reference says what is left of an effect. A redrawn noise is known by its
        level alone: what it moves by more than a quarter is not believed.
        """
        if not self.differs(tested):
            return False
        shift, slots = self._shift(tested)
        own = self.covariance[np.ix_(slots, slots)]
        nothing = chance_of(self.theta[slots], own, LEAST) > RULES.noise_nothing
        sd = np.sqrt(np.diag(self.fit.covariance())[slots])
        part = np.linalg.norm(shift / sd) / np.linalg.norm(self.fit.theta[slots] / sd)
        return nothing or (self.how == EFFECTIVE and bool(part > RULES.noise_part))

    def estimate(self, tested: Tested) -> tuple[Array, Array]:
        """Coefficients of a member, and their doubt beside the fit's. (k,), (k, k).

        Where the noise makes a difference they are those without it. Of what a redrawn
        noise moves, a half is doubted.
        """
        shift, slots = self._shift(tested)
        theta, square = self.fit.theta[slots], np.outer(shift, shift)
        redrawn = self.how == EFFECTIVE
        if self.differs(tested):
            spread = self.spread[np.ix_(slots, slots)]
            return theta + shift, spread + redrawn * square / 4
        return theta, redrawn * square

    def _shift(self, tested: Tested) -> tuple[Array, Array]:
        slots = self.fit.slots(tested.group)
        return (self.theta - self.fit.theta)[slots], slots

    def _spread(self, slots: Array) -> Array:
        own = self.spread[np.ix_(slots, slots)]
        return own + LEAST * np.diag(np.diag(self.covariance)[slots])


def drop_noise(
    examined: Examined, judged: Verdicts, recordings: Sequence[Recording]
) -> tuple[Verdicts, Checked | None, tuple[Tested, ...]]:
    """Drop the names that noise of the angles made.

    Args:
        recordings: The fit logs, in the diagnosis' order.

    Returns:
        The names that stand, how their fit was checked (None where there are none), and
        the names that are noise.
    """
    gone: list[Tested] = []
    while judged.kept:
        checks = checked(examined, judged.fit, recordings)
        noise = [t for t, _ in judged.kept if checks.is_noise(t)]
        if not noise:
            return judged, checks, tuple(gone)
        gone += noise
        judged = without(examined, judged, noise)
    return judged, None, tuple(gone)


def noise_notes(checks: Checked | None, tested: Sequence[Tested]) -> tuple[str, ...]:
    """What noise of the angles did to the named effects: one sentence, or none."""
    if checks is None:
        return ()
    off = ", ".join(sorted({t.group.effect.name for t in tested if checks.differs(t)}))
    if checks.how == EFFECTIVE:
        share = 100 * np.nanmax(checks.share)
        moved = f"parameters of {off} are corrected for it, " if off else ""
        said = (
            "no reference (q_ref) in every log: noise of the angles, redrawn as it was "
            f"measured, makes {share:.1f} % of a joint's residual variance at most; "
            f"{moved}standard deviations allow for it (effective variance)"
        )
    elif off:
        said = (
            f"errors in variables: the reference contradicts least squares on {off} "
            "(Durbin-Wu-Hausman, 0.1 %); parameters there are those by instruments"
        )
    else:
        said = (
            "errors in variables: instruments made of the reference agree with least "
            "squares on every named effect (Durbin-Wu-Hausman)"
        )
    return (said,)


def checked(
    examined: Examined, fitted: Fit, recordings: Sequence[Recording]
) -> Checked:
    """Check a fit by its reference where every log has one, else by redrawn noise.

    Args:
        recordings: The fit logs, in the diagnosis' order.
    """
    if all(r.q_ref is not None for r in recordings):
        logs = examined.logs
        recordings = in_pieces(recordings, logs.filters.torque)
        asked = [replace(r, q=r.q_ref, qd=None, qdd=None) for r in recordings]
        tracks, _ = prepare(asked, logs.filters, logs.speed_floor)
        return _by_instruments(examined, fitted, on_rows_of(logs.tracks, tracks))
    return _by_redrawing(examined, fitted, examined.logs.shaken)


def _by_instruments(examined: Examined, fitted: Fit, tracks) -> Checked:
    """Two-stage least squares under the fit's own prior and noise."""
    design, other, ids = examined.task.design, *_seen(examined, fitted, tracks)
    system = System.of(design, examined.task.prior, fitted.members)
    weight = fitted.weight(design.rows)
    precision, pull = system.precision.copy(), system.pull.copy()
    for j in range(design.dof):
        place, have = design.present(j, fitted.ids)
        real = design.chunks(j, place)
        instruments = other.chunks(j, other.present(j, ids)[0])
        inner, pulled = _projected(real, instruments)
        precision[np.ix_(have, have)] += weight[j] * inner
        pull[have] += weight[j] * pulled
    covariance = scaled_inverse(precision)
    return Checked(
        how=INSTRUMENTS,
        fit=fitted,
        theta=covariance @ pull,
        covariance=covariance,
        spread=covariance - fitted.covariance(),
        share=np.full(design.dof, np.nan),
    )


def _by_redrawing(examined: Examined, fitted: Fit, tracks) -> Checked:
    """The normal equations without the noise that one more helping of it shows.

    Least squares solves (S + N) x = S b, with S what exact columns would give and N the
    noise's own: b is had back where N is known.
    """
    design, other, ids = examined.task.design, *_seen(examined, fitted, tracks)
    if any(Trait.USES_MODEL in g.effect.traits for g in fitted.members):
        # Seen with the same model, else what it changed would be taken for noise.
        design, own = _seen(examined, fitted, examined.logs.sketch)
    else:
        own = fitted.ids
    rows = examined.task.design.rows
    weight = fitted.weight(rows)
    start, size = np.zeros(len(ids)), len(ids)
    start[: len(design.nominal)] = examined.nominal.model.coefficients()
    noise, share = np.zeros((size, size)), np.zeros(design.dof)
    for j in range(design.dof):
        place, have = design.present(j, own)
        moved = other.columns(j, other.present(j, ids)[0]) - design.columns(j, place)
        # Of a long log the noise was redrawn on a sketch of its rows.
        scale = rows[j] / max(len(moved), 1)
        noise[np.ix_(have, have)] += scale * weight[j] * moved.T @ moved
        torque = moved @ (start + fitted.theta)[have]
        share[j] = scale * torque @ torque / max(fitted.sse[j], 1e-300)
    lower = np.tril(fitted.cholesky)
    half = solve_triangular(lower, noise, lower=True)
    values, vectors = np.linalg.eigh(solve_triangular(lower, half.T, lower=True))
    turned = solve_triangular(lower, vectors, lower=True, trans=1)
    left = 1 - np.clip(values, 0, RULES.noise_most)
    pull = vectors.T @ (lower.T @ fitted.theta) + values * (vectors.T @ lower.T @ start)
    covariance = (turned / left) @ turned.T
    return Checked(
        how=EFFECTIVE,
        fit=fitted,
        theta=turned @ (pull / left),
        covariance=covariance,
        spread=covariance - fitted.covariance(),
        share=share,
    )


def _seen(examined: Examined, fitted: Fit, tracks) -> tuple[Design, Array]:
    """The fit's columns as other angles give them, on the very same rows."""
    nominal = examined.nominal
    other = replace(examined.logs, tracks=tracks)
    design = first_design(other, nominal, physical(as_model(nominal, fitted)))
    members = design.add([g.placed for g in fitted.members])
    return design, np.concatenate([design.nominal, *(g.ids for g in members)])


def _projected(real: Iterable, instruments: Iterable) -> tuple[Array, Array]:
    """Products of what of the columns x lies in the span of the instruments z.

    Args:
        real: Columns and target, x (n, k) and y (n,), piece by piece.
        instruments: The same of the reference, of which z (n, m) is taken.

    Returns:
        x'Px and x'Py, P the projection on z. Shapes (k, k), (k,).
    """
    zz, zx, zy = 0.0, 0.0, 0.0
    for (x, y), (z, _) in zip(real, instruments, strict=True):
        zz, zx, zy = zz + z.T @ z, zx + z.T @ x, zy + z.T @ y
    size = np.sqrt(np.diag(zz))
    some = np.flatnonzero(size > 0)
    unit = 1 / size[some]
    values, vectors = np.linalg.eigh(zz[np.ix_(some, some)] * np.outer(unit, unit))
    sound = values > FLAT * values.max(initial=0.0)
    basis = (vectors[:, sound] / np.sqrt(values[sound])) * unit[:, None]
    seen = basis.T @ zx[some]
    return seen.T @ seen, seen.T @ (basis.T @ zy[some])


# Standard deviations of what is reported: noise, logs that disagree, other forms.


USUAL = 0.975  # quantile at two standard deviations
STEP = 1e-3  # relative step of the numerical derivatives


@dataclass(frozen=True, eq=False, slots=True)
class Doubt:
    """How well a member is known."""

    std: Array  # standard deviation of each parameter, (parameters,)
    prior: Array  # the same before the logs spoke, (parameters,)
    theta: Array  # standard deviation of each coefficient, and before, (2, k)
    # Chance of coefficients so far from zero if they were zero, and the rest as good as
    # the logs say.
    chance: float


def standard_deviations(
    examined: Examined, fitted: Fit, sizes: Mapping[Group, tuple[Array, Array]]
) -> dict[Group, Doubt]:
    """Standard deviation of every parameter of every member.

    The largest of three: by the noise, by how much logs disagree, and by other forms of
    the effect. A searched shape is uncertain too: its derivative columns join the fit
    (Gauss-Newton), and the parameters' covariance follows by linearisation.

    Args:
        sizes: For each member its coefficients and what is doubtful of them
            beside the noise. Shapes (k,), (k, k).

    Returns:
        What is known of each member.
    """
    task, robot = examined.task, examined.logs.robot
    extra = {g: _slope(task.design, g, fitted.of(g)) for g in fitted.members}
    slopes = [s for s in extra.values() if s is not None]
    members = (*fitted.members, *slopes)
    known = fitted.counted, fitted.variance, 1
    full = fit(task.design, examined.wide, members, *known)
    covariance, between = full.covariance(), between_logs(task.design, full)
    sharp = fit(task.design, doubtful(examined), members, *known).covariance()
    out = {}
    for g in fitted.members:
        slope, (theta, doubt) = extra[g], sizes[g]
        slots = full.slots(g)
        if slope is not None:
            slots = np.concatenate([slots, full.slots(slope)])
        searched = slope is not None
        jacobian = values_jacobian(g.effect, theta, g.shape, robot, searched)
        own = [c[np.ix_(slots, slots)] for c in (covariance, between, sharp)]
        for c in own:
            c[: len(theta), : len(theta)] += doubt
        form = _form_doubt(examined, fitted, g)
        prior = _prior_std(g, slope, jacobian)
        out[g] = _doubt(g, theta, own, jacobian, form, prior)
    return out


def doubtful(examined: Examined) -> Prior:
    """The prior that a wrong value must stand out from: bodies one step rougher.

    Their scale is an estimate from few sums of many parameters, good to such a step.
    """
    prior, wide = examined.task.prior, examined.wide
    if prior.scale >= wide.scale:
        return wide
    rougher = min([s for s in OF_NAMES if s > prior.scale], default=wide.scale)
    space = Space(examined.task.design, examined.nominal)
    return space.at(min(rougher, wide.scale), prior.widths)


def _doubt(
    group: Group,
    theta: Array,
    own: Sequence[Array],
    jacobian: Array,
    form: Array,
    prior: Array,
) -> Doubt:
    """Sum up the covariances of one member: by noise, between logs, and at best."""
    by_noise, between, best = own
    wide = (by_noise, between)
    variance = [np.einsum("ij,jk,ik->i", jacobian, c, jacobian) for c in wide]
    std = np.sqrt(np.maximum.reduce([*variance, form**2]))
    k = len(theta)
    # A structure must stand out though bodies may be off by as much as logs allow;
    # that a value is wrong is asked of this value, the others as good as they are.
    least = best if Trait.PARAMETER in group.effect.traits else by_noise
    told = (least, least + between)
    chance = max(chance_of(theta, c[:k, :k], FLAT) for c in told)
    before = np.diag(scaled_inverse(group.precision))
    after = np.maximum.reduce([np.diag(c)[:k] for c in wide])
    deviations = np.sqrt(np.maximum([after, before], 0.0))
    return Doubt(std, prior, deviations, chance)


def _prior_std(group: Group, slope: Group | None, jacobian: Array) -> Array:
    """Standard deviation of the parameters by the prior alone. Shape (parameters,)."""
    parts = [group, *([] if slope is None else [slope])]
    blocks = [scaled_inverse(part.precision) for part in parts]
    covariance = block_diag(*blocks)
    return np.sqrt(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian))


def between_logs(design: Design, full: Fit) -> Array:
    """Covariance by how much the logs disagree on the coefficients. Shape (m, m).

    No effect has the very form of a textbook, and what is left of it pulls each log its
    own way: a sandwich of the scores of the folds (Liang & Zeger 1986). Of so few, two
    standard deviations are made to hold what Student's t holds.
    """
    weight = full.weight(design.rows)
    pulls = np.zeros((design.folds, len(full.ids)))
    for j in range(design.dof):
        place, have = design.present(j, full.ids)
        gram, cross = design.fold_sums(j, place)
        left = cross - gram @ full.theta[have]
        pulls[:, have] += weight[j] * left
    pulls -= pulls.mean(axis=0)  # the prior's own pull is shared by all
    moved = pulls @ full.covariance()
    free = max(design.folds - 1, 1)
    wider = float(stdtrit(free, USUAL) / ndtri(USUAL))
    return wider**2 * design.folds / free * moved.T @ moved


def _form_doubt(examined: Examined, fitted: Fit, group: Group) -> Array:
    """Half of what another form of the same effect would change. Shape (parameters,).

    Stribeck's curve falls as exp(-x) in one textbook and as exp(-x^2) in another: what
    logs hold of it does not reach down to standstill, where its level is said.
    """
    task, effect = examined.task, group.effect
    robot = examined.logs.robot
    own = np.asarray(effect.values(fitted.of(group), group.shape, robot), dtype=float)
    anchor = group.joints[0] if group.joints else 0
    forms = {shape[1:] for shape in effect.shapes(examined.logs.span, anchor)}
    units = np.array(list(effect.parameters.values()))
    sizes = [np.linalg.norm(own[units == unit]) for unit in units]
    doubt = effect.inexact * np.array(sizes)
    for form in sorted(forms - {group.shape[1:]}):
        shape = (group.shape[0], *form)
        made = task.design.add([group.placed._replace(shape=shape)])
        rest = [g for g in fitted.members if g is not group]
        *_, best = refined(task, (*rest, *made), fitted)
        theta = task.fit((*rest, best), fitted).of(best)
        doubt = np.maximum(
            doubt, abs(effect.values(theta, best.shape, robot) - own) / 2
        )
    return doubt


def _slope(design: Design, group: Group, theta: Array) -> Group | None:
    """Column of the derivative to the searched shape, as a group of its own."""
    effect = group.effect
    if effect.refine is None:
        return None
    x, rest = group.shape[0], group.shape[1:]
    step = STEP * abs(x)

    def columns(state, joints, shape):
        above = effect.columns(state, joints, (x + step, *rest))
        below = effect.columns(state, joints, (x - step, *rest))
        return ((above - below) @ theta / (2 * step))[:, :, None]

    derivative = Effect(effect.name, "", {}, columns, scope=effect.scope)
    (made,) = design.add([Placed(derivative, group.joints, ())])
    # The search was confined to the shape's own scale: 100 % of it, one sigma.
    width = abs(x)
    return Group(
        derivative, group.joints, (), made.ids, np.eye(1) / width**2, -2 * np.log(width)
    )


def values_jacobian(
    effect: Effect, theta: Array, shape: Shape, robot: Robot, with_shape: bool = False
) -> Array:
    """Derivative of an effect's parameter values to its coefficients.

    Args:
        theta: Its coefficients. Shape (k,).
        shape: Its shape.
        with_shape: Whether the first number of the shape comes last.

    Returns:
        Shape (parameters, k) or (parameters, k + 1).
    """
    start = np.concatenate([theta, shape[:1] if with_shape else []])

    def values(x: Array) -> Array:
        at = (x[-1], *shape[1:]) if with_shape else shape
        return np.asarray(effect.values(x[: len(theta)], at, robot), dtype=float)

    columns = []
    for i, x in enumerate(start):
        step = STEP * max(abs(x), 1e-6)
        shift = np.eye(len(start))[i] * step
        columns.append((values(start + shift) - values(start - shift)) / (2 * step))
    return np.column_stack(columns)
