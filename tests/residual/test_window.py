"""Sums over bins say what dense algebra on the same rows says."""

import numpy as np
import pytest

from residual.epochs.rules import Watching
from residual.epochs.window import (
    BODY,
    COURSE,
    GAIN,
    SLOW,
    Usual,
    follow,
    nothing,
    products,
)

RULES = Watching(rows=7, windows=(2, 5), uncertain=3)
DOF, FREE = 2, 3
COLUMNS = 1 + FREE + SLOW + BODY + 3
BINS, SECOND = 9, 0.5


@pytest.fixture(scope="module")
def usual() -> Usual:
    rng = np.random.default_rng(1)
    return Usual(
        noise=rng.uniform(0.5, 2.0, DOF),
        unrest=rng.uniform(1.0, 2.0, (2, DOF)),
        slow=rng.uniform(0.1, 0.5, (DOF, SLOW)),
        quick=rng.uniform(0.01, 0.1, (DOF, SLOW)),
        body=np.array([2.0, 0.4, 0.4, 0.4]),
        single=rng.uniform(0.2, 2.0, (DOF, 5)),
    )


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    rng = np.random.default_rng(2)
    return rng.normal(size=(BINS * RULES.rows, DOF, COLUMNS))


def looked(usual: Usual, rows: np.ndarray, cuts=(), shift: float = 0.0):
    past, looks = nothing(usual, COLUMNS, RULES), []
    gram = products(rows, RULES)
    clock = shift + SECOND * np.arange(1, BINS + 1)
    for first, stop in zip((0, *cuts), (*cuts, BINS), strict=True):
        past, own = follow(usual, RULES, past, gram[first:stop], clock[first:stop])
        looks.append(own)
    return past, looks


def dense(usual: Usual, rows: np.ndarray, j: int, w: int):
    """Precision-weighted columns of the first window: V^-1 C, C and r of one joint."""
    many = RULES.windows[w]
    own = rows[: many * RULES.rows, j]
    r, free, slow = own[:, 0], own[:, 1 : 1 + FREE], own[:, 1 + FREE : 3 + FREE]
    ends = SECOND * np.arange(1, many + 1)
    time = np.sqrt(3) / RULES.memory * (ends - 0.5 * (ends[0] + ends[-1]))
    course = slow[:, 0] * np.repeat(time, RULES.rows)
    some = np.column_stack([slow, course])
    prior = usual.cold(RULES)[j][COURSE][:, COURSE]
    quick = np.diag([*usual.quick[j] ** 2, 0.0])
    v = usual.noise[j] * np.eye(len(r)) + free @ free.T
    v = (v + some @ (prior + quick) @ some.T) * usual.unrest[w, j] ** 2
    c = np.column_stack([own[:, 3 + FREE : 7 + FREE], slow, own[:, 7 + FREE :]])
    return np.linalg.solve(v, c), c, r


@pytest.mark.parametrize("w", [0, 1])
def test_a_window_is_generalised_least_squares_on_its_rows(usual, rows, w):
    _, (looks,) = looked(usual, rows)
    at = RULES.windows[w] - 1  # the first bin behind a whole window
    info, pull = np.diag(1 / usual.body**2), np.zeros(BODY)
    for j in range(DOF):
        weighed, c, r = dense(usual, rows, j, w)
        full = weighed.T @ c
        info = info + full[:BODY, :BODY]
        pull = pull + weighed[:, :BODY].T @ r
        own = full.diagonal()[BODY:] + 1 / usual.single[j] ** 2
        np.testing.assert_allclose(
            looks.size[at, w, j], (weighed[:, BODY:].T @ r) / own, rtol=1e-8
        )
        np.testing.assert_allclose(looks.std[at, w, j], own**-0.5, rtol=1e-8)
    np.testing.assert_allclose(
        looks.mass[0][at, w], np.linalg.solve(info, pull), rtol=1e-8
    )
    np.testing.assert_allclose(looks.mass[1][at, w], np.linalg.inv(info), rtol=1e-8)


@pytest.mark.parametrize("cuts", [(1, 2, 3), (4,), (8,)])
def test_bins_may_come_in_any_batches(usual, rows, cuts):
    past, looks = looked(usual, rows, cuts)
    whole, (every,) = looked(usual, rows)
    nats = np.concatenate([x.nats() for x in looks])
    np.testing.assert_allclose(nats, every.nats(), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(past.cov, whole.cov, rtol=1e-9, atol=1e-12)


def test_it_does_not_matter_when_the_clock_began(usual, rows):
    _, (one,) = looked(usual, rows)
    _, (other,) = looked(usual, rows, shift=1e6)
    np.testing.assert_allclose(one.nats(), other.nats(), rtol=1e-6)


def test_a_gain_has_evidence_on_its_joint_and_nothing_has_none(usual, rows):
    quiet = rows.copy()
    quiet[..., 0] = 0.0
    _, (nothing_there,) = looked(usual, quiet)
    assert nothing_there.nats().max() <= 0.0
    loud = quiet.copy()
    loud[:, 1, 0] = 3.0 * loud[:, 1, -3]  # the column of a gain
    _, (looks,) = looked(usual, loud)
    nats = looks.nats()[-1, -1]
    assert int(nats.argmax()) == 1 + GAIN * DOF + 1


def test_what_was_before_a_pause_is_forgotten(usual, rows):
    gram = products(rows, RULES)
    clock = SECOND * np.arange(1, BINS + 1)
    late = np.where(np.arange(BINS) < 4, clock, clock + 10 * RULES.pause)
    fresh = nothing(usual, COLUMNS, RULES)
    _, both = follow(usual, RULES, fresh, gram, late)
    _, alone = follow(usual, RULES, fresh, gram[4:], late[4:])
    np.testing.assert_allclose(both.nats()[4:], alone.nats(), rtol=1e-7, atol=1e-9)
