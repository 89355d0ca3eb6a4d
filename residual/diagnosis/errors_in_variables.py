"""Noise of the angles in the regressor: what it does to a fit, and the remedy.

Least squares treats the regressor as exact. It is computed from measured angles and
contains their noise, and with noise in the feedback so does the torque. A reference is
independent of both: columns computed from it are instruments (two-stage least squares;
Janot, Vandanjon, Gautier 2014), and if both estimates differ beyond chance, least squares
was biased (Durbin, Wu, Hausman; Janot et al. 2016). Without a reference the measured
noise is redrawn and removed from the normal equations; the resulting shift counts as
uncertainty (effective variance).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from residual.diagnosis.outcome import Outcome
from residual.diagnosis.select import Member
from residual.effects.base import EffectTrait
from residual.evidence.design import Design
from residual.evidence.fit import (
    Fit,
    FitEquations,
    build_fitted_model,
    compute_zero_chance,
    invert_scaled,
    keep_physical_terms,
)
from residual.evidence.priors import build_first_design
from residual.evidence.thresholds import THRESHOLDS
from residual.recording import Array, Recording
from residual.signals.track import build_tracks, keep_measured_rows

INSTRUMENTS, EFFECTIVE = "instruments", "effective variance"
FLAT = 1e-9  # of the largest singular value or correlation: less is zero
LEAST = 1e-3  # of its variance: least variance of a difference


@dataclass(frozen=True, eq=False, slots=True)
class AngleNoiseCheck:
    """A fit, checked against the noise of the angles."""

    method: str  # "instruments" or "effective variance"
    fit: Fit  # the fit that was checked
    # Coefficients by instruments; without them those of the fit, corrected for the
    # noise, (m,).
    theta: Array
    covariance: Array  # of ``theta``, (m, m)
    spread: Array  # excess over that of the fit, (m, m)
    # Share of each joint's residual variance due to noise of the angles; NaN with
    # instruments, (dof,).
    share: Array

    def differs(self, tested: Member) -> bool:
        """Whether the fit without the noise differs beyond chance."""
        shift, slots = self._shift(tested)
        spread = self.spread[np.ix_(slots, slots)]
        spread = spread + LEAST * np.diag(np.diag(self.covariance)[slots])
        return compute_zero_chance(shift, spread, LEAST) < THRESHOLDS.noise_chance

    def estimate(self, tested: Member) -> tuple[Array, Array]:
        """Coefficients of a member, and their additional covariance. (k,), (k, k).

        If the noise matters they are those without it. Half of the shift by redrawn
        noise counts as uncertainty.
        """
        shift, slots = self._shift(tested)
        theta, square = self.fit.theta[slots], np.outer(shift, shift)
        redrawn = self.method == EFFECTIVE
        if self.differs(tested):
            spread = self.spread[np.ix_(slots, slots)]
            return theta + shift, spread + redrawn * square / 4
        return theta, redrawn * square

    def _shift(self, tested: Member) -> tuple[Array, Array]:
        slots = self.fit.slots(tested.group)
        return (self.theta - self.fit.theta)[slots], slots


def describe_angle_noise(
    checks: AngleNoiseCheck | None, tested: Sequence[Member]
) -> tuple[str, ...]:
    """Describe the influence of angle noise on the findings: one sentence, or none."""
    if checks is None:
        return ()
    corrected = ", ".join(sorted({t.group.effect.name for t in tested if checks.differs(t)}))
    if checks.method == EFFECTIVE:
        share = 100 * np.nanmax(checks.share)
        moved = f"parameters of {corrected} are corrected for it; " if corrected else ""
        note = (
            "no reference (q_ref) in every log: noise of the angles, redrawn as it was "
            f"measured, makes {share:.1f} % of a joint's residual variance at most; "
            f"{moved}standard deviations allow for it (effective variance)"
        )
    elif corrected:
        note = (
            "errors in variables: the reference contradicts least squares on "
            f"{corrected} (Durbin-Wu-Hausman, 0.1 %); its parameters are those by "
            "instruments"
        )
    else:
        note = (
            "errors in variables: instruments made of the reference agree with least "
            "squares on every named effect (Durbin-Wu-Hausman)"
        )
    return (note,)


def check_angle_noise(
    outcome: Outcome, fitted: Fit, recordings: Sequence[Recording]
) -> AngleNoiseCheck:
    """Check a fit with references if every log has one, else with redrawn noise.

    Args:
        recordings: The fit logs, or pieces of long ones, in the diagnosis' order.
    """
    if all(r.q_ref is not None for r in recordings):
        logs = outcome.logs
        commanded = [replace(r, q=r.q_ref, qd=None, qdd=None) for r in recordings]
        tracks, _ = build_tracks(commanded, logs.filters, logs.speed_floor)
        return _by_instruments(outcome, fitted, keep_measured_rows(logs.tracks, tracks))
    return _by_redrawing(outcome, fitted, outcome.logs.shaken)


def _by_instruments(outcome: Outcome, fitted: Fit, tracks) -> AngleNoiseCheck:
    """Two-stage least squares under the fit's own prior and noise."""
    design, other, ids = outcome.design, *_design_with(outcome, fitted, tracks)
    system = FitEquations.of(design, outcome.prior, fitted.members)
    weight = fitted.weight
    precision, pull = system.precision.copy(), system.pull.copy()
    for j in range(design.dof):
        place, have = design.present(j, fitted.ids)
        real, instruments = design.columns(j, place), other.columns(j, other.present(j, ids)[0])
        inner, pulled = _project(real, design.target[j], instruments)
        precision[np.ix_(have, have)] += weight[j] * inner
        pull[have] += weight[j] * pulled
    covariance = invert_scaled(precision)
    return AngleNoiseCheck(
        method=INSTRUMENTS,
        fit=fitted,
        theta=covariance @ pull,
        covariance=covariance,
        spread=covariance - fitted.covariance(),
        share=np.full(design.dof, np.nan),
    )


def _by_redrawing(outcome: Outcome, fitted: Fit, tracks) -> AngleNoiseCheck:
    """Solve the normal equations corrected for noise, measured by redrawing it.

    Least squares solves (S + N) x = S b, with S from exact columns and N from the noise:
    b follows if N is known.
    """
    design, other, ids = outcome.design, *_design_with(outcome, fitted, tracks)
    if any(EffectTrait.USES_MODEL in g.effect.traits for g in fitted.members):
        # Use the same model, since a changed one would look like noise.
        design, own = _design_with(outcome, fitted, outcome.logs.tracks)
    else:
        own = fitted.ids
    weight = fitted.weight
    start, size = np.zeros(len(ids)), len(ids)
    start[: len(design.nominal)] = outcome.nominal.model.coefficients()
    noise, share = np.zeros((size, size)), np.zeros(design.dof)
    for j in range(design.dof):
        place, have = design.present(j, own)
        moved = other.columns(j, other.present(j, ids)[0]) - design.columns(j, place)
        noise[np.ix_(have, have)] += weight[j] * moved.T @ moved
        torque = moved @ (start + fitted.theta)[have]
        share[j] = torque @ torque / max(fitted.sse[j], 1e-300)
    lower = np.tril(fitted.cholesky)
    half = solve_triangular(lower, noise, lower=True)
    values, vectors = np.linalg.eigh(solve_triangular(lower, half.T, lower=True))
    turned = solve_triangular(lower, vectors, lower=True, trans=1)
    left = 1 - np.clip(values, 0, THRESHOLDS.max_noise_information)
    pull = vectors.T @ (lower.T @ fitted.theta) + values * (vectors.T @ lower.T @ start)
    covariance = (turned / left) @ turned.T
    return AngleNoiseCheck(
        method=EFFECTIVE,
        fit=fitted,
        theta=turned @ (pull / left),
        covariance=covariance,
        spread=covariance - fitted.covariance(),
        share=share,
    )


def _design_with(outcome: Outcome, fitted: Fit, tracks) -> tuple[Design, Array]:
    """The fit's columns computed from other angles, on the same rows."""
    nominal = outcome.nominal
    other = replace(outcome.logs, tracks=tracks)
    design = build_first_design(
        other, nominal, keep_physical_terms(build_fitted_model(nominal, fitted))
    )
    members = design.add([g.placed for g in fitted.members])
    return design, np.concatenate([design.nominal, *(g.ids for g in members)])


def _project(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Products of the projection of columns x (n, k) on the span of instruments z.

    Returns:
        x'Px and x'Py, P the projection on z (n, m). Shapes (k, k), (k,).
    """
    zz, zx, zy = z.T @ z, z.T @ x, z.T @ y
    size = np.sqrt(np.diag(zz))
    nonzero = np.flatnonzero(size > 0)
    unit = 1 / size[nonzero]
    values, vectors = np.linalg.eigh(zz[np.ix_(nonzero, nonzero)] * np.outer(unit, unit))
    kept = values > FLAT * values.max(initial=0.0)
    basis = (vectors[:, kept] / np.sqrt(values[kept])) * unit[:, None]
    projected = basis.T @ zx[nonzero]
    return projected.T @ projected, projected.T @ (basis.T @ zy[nonzero])
