"""What a motion cannot tell, before anything is fitted to it; and which motion could.

The standard deviation that a parameter would have is sqrt((A^-1)_ii), with A the
information of the rows under the noise of each joint. A parameter cannot be told if
that exceeds all by which it could be off anyway: its whole nominal value and more than
a usual load would add.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from residual.identification.structure import columns_of, state_at
from residual.model.model import Model
from residual.recording import Array
from residual.robot.base_parameters import BaseParameters

_STATES = 120  # of a motion that is tried
_WEAK = 0.3
_LIMIT = 1.0
_FAST, _HARD = 1.5, 5.0  # rad/s, rad/s^2 where a robot has no limits
_LARGEST = 1e9


@dataclass(frozen=True, eq=False, slots=True)
class Unidentified:
    """A parameter that the motion does not show.

    Attributes:
        index: Which base parameter.
        sd: Standard deviation that it would have [SI].
        remedy: Which motion would show it, in words.
    """

    index: int
    sd: float
    remedy: str


@dataclass(frozen=True, eq=False, slots=True)
class Preflight:
    """What a motion can tell.

    Attributes:
        doubt: Expected standard deviation of each parameter over its size, with all
            that are not held free. Shape (b,).
        held: Parameters that are better left at their nominal value.
        weak: Parameters known to no better than 30 % of that. Shape (k,).
        standing: Joints that never move, from 1.
    """

    doubt: Array
    held: tuple[Unidentified, ...]
    weak: Array
    standing: tuple[int, ...]

    @property
    def free(self) -> Array:
        """Parameters that the motion shows. Shape (k,)."""
        held = [u.index for u in self.held]
        return np.setdiff1d(np.arange(len(self.doubt)), held)

    def lines(self, base: BaseParameters) -> list[str]:
        """Say it in words, a line each."""
        out = []
        if self.standing:
            joints = ", ".join(map(str, self.standing))
            out.append(
                f"joint {joints} never moves: nothing acts on it that can be told"
            )
        for one in self.held:
            lead = base.leading[one.index]
            out.append(
                f"{lead.name} cannot be told from this motion (at best to "
                f"{one.sd:.3g} {lead.unit}) and stays nominal; {one.remedy}"
            )
        return out


def preflight(
    model: Model, base: BaseParameters, information: Array, size: Array, rows: Array
) -> Preflight:
    """Say which parameters a motion cannot tell, and which motion would.

    Args:
        information: A: weighted x'x of the rows, in SI units. Shape (b, b).
        size: How far each base parameter may be off at all. Shape (b,).
        rows: Weight of one row of each joint, and how many there are: w_j, m_j.
            Shape (2, dof).

    Returns:
        What can be told.
    """
    scaled = information * np.outer(size, size)
    free, held = list(range(len(size))), []
    while free:
        doubts = _doubt(scaled[np.ix_(free, free)])
        worst = int(np.argmax(doubts))
        if doubts[worst] <= _LIMIT:
            break
        held.append((free.pop(worst), float(doubts[worst])))
    expected = np.full(len(size), np.inf)
    expected[free] = _doubt(scaled[np.ix_(free, free)]) if free else []
    remedies = _remedies(model, base, scaled, (size, rows, free), [i for i, _ in held])
    return Preflight(
        doubt=expected,
        held=tuple(
            Unidentified(i, doubt * size[i], remedies[i]) for i, doubt in sorted(held)
        ),
        weak=np.array([i for i in free if expected[i] > _WEAK], dtype=int),
        standing=tuple(int(j) + 1 for j in np.flatnonzero(rows[1] == 0)),
    )


def _doubt(scaled: Array) -> Array:
    """Expected sd of each parameter in units of its size, at most 1e9."""
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, _LARGEST**-2)
    return np.sqrt((vectors**2 / values).sum(axis=1))


def _remedies(
    model: Model, base: BaseParameters, scaled: Array, context: tuple, held: list[int]
) -> dict[int, str]:
    """The least motion, beside what there is, that shows each held parameter."""
    size, rows, free = context
    out: dict[int, str] = {}
    if not held:
        return out
    # As many rows as the logs have, so that it is the motion that counts, not time.
    per_row = rows[0] * max(rows[1].max(), 1.0) / _STATES
    for words, states in _motions(model):
        columns = columns_of(model, state_at(model, *states))[:, :, base.columns]
        columns = columns * size * np.sqrt(per_row)[None, :, None]
        flat = columns.reshape(-1, len(size))
        richer = scaled + flat.T @ flat
        for i in held:
            if i in out:
                continue
            ids = [*free, i]
            if _doubt(richer[np.ix_(ids, ids)])[-1] <= _LIMIT:
                out[i] = f"it needs {words}"
        if len(out) == len(held):
            return out
    nothing = "no motion within the limits of the arm would show it at this noise"
    return {i: out.get(i, nothing) for i in held}


def _motions(model: Model):
    """Motions to try, the simplest first: words, and q, qd, qdd of random states."""
    robot, rng = model.robot, np.random.default_rng(0)
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    speed = np.where(np.isfinite(robot.velocity_limit), robot.velocity_limit, 2 * _FAST)
    hard = robot.acceleration_limit
    hard = np.full(robot.dof, 2 * _HARD) if hard is None else hard
    draw = rng.uniform(-0.5, 0.5, (3, _STATES, robot.dof))
    q, qd, qdd = (
        (low + high) / 2 + 0.8 * (high - low) * draw[0],
        speed * draw[1],
        hard * draw[2],
    )
    joints = range(robot.dof)
    for some in [*((j,) for j in joints), *combinations(joints, 2), tuple(joints)]:
        keep = np.isin(joints, some)
        named = " and ".join(str(j + 1) for j in some)
        whole = (
            "all joints at once"
            if len(some) == robot.dof
            else (f"joint{'s' if len(some) > 1 else ''} {named}")
        )
        middle = np.where(keep, q, (low + high) / 2)
        yield f"motion of {whole}", (middle, qd * keep, qdd * keep)
