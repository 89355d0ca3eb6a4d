"""The recursions over rows: whitening, and sums of evidence that start anew at zero.

Noise of neighbouring rows is alike, so residual and signature both pass the filter that
makes the residual of healthy runs white, e_k = r_k - sum_i a_i r_(k-i) (an additive
change in correlated noise: Basseville & Nikiforov 1993, section 7.2). Of the white rest
the log-likelihood ratio of a change of size theta is

s_k = rho(e_k / sigma) - rho((e_k - theta f_k) / sigma)

with rho(x) = x^2 / 2, and beyond two standard deviations only as |x|, so that bursts
behind a reversal count less (Huber 1964). Page's sum g_k = max(0, g_(k-1) + s_k) says
how much speaks for a change at the time since which it has not been zero (Page 1954).
Row by row, so that nothing depends on how the rows are cut into batches.
"""

import numba
import numpy as np

CLIP = 2.0  # standard deviations up to which the loss is that of a normal variable


@numba.njit(cache=True)
def whiten(x, slow, begins, filters, memory, carried):
    """Filter features and residual row by row, and say which can be used.

    Args:
        x: Residual and features. Shape (m, dof, c).
        slow: The joint stands or nearly so. Shape (m, dof), bool.
        begins: A piece begins at this row. Shape (m,), bool.
        filters: Coefficients a_i of each joint. Shape (p, dof).
        memory: Rows after standing in which a joint is not to be trusted.
        carried: The last p rows, the latest first, shape (p, dof, c); rows that each
            joint is still not to be trusted, shape (dof,); both are changed. And the
            rows in the piece so far.

    Returns:
        The filtered rows, where each joint counts, and the rows in the piece.
    """
    lags, rest, count = carried
    out, use = np.zeros(x.shape), np.zeros(slow.shape, dtype=np.bool_)
    for k in range(len(x)):
        if begins[k]:
            count = 0
            rest[:] = 0
        _rested(slow[k], rest, memory)
        use[k] = (rest == 0) & (count >= len(filters))
        out[k] = x[k]
        for i in range(len(filters)):
            for j in range(x.shape[1]):
                out[k, j] -= filters[i, j] * lags[i, j]
        for i in range(len(filters) - 1, 0, -1):
            lags[i] = lags[i - 1]
        lags[0] = x[k]
        count += 1
    return out, use, count


@numba.njit(cache=True)
def _rested(slow, rest, memory):
    """Count down the rows in which a joint that stood is not to be trusted."""
    for j in range(len(rest)):
        rest[j] = memory if slow[j] else max(rest[j] - 1, 0)


@numba.njit(cache=True)
def page(rows, sizes, settings, carried):
    """Add up evidence row by row, and tell where it passes a limit.

    A sum that passes its limit starts anew. Until none has for a while, it is the same
    alarm.

    Args:
        rows: White residual over its standard deviation, shape (m, dof); white
            features over the same, load first, shape (m, dof, 4); both 0 where they do
            not count. And whether a joint moves, 1 or 0, shape (m,).
        sizes: Sizes of change that are looked for, signed. Shape (h, s).
        settings: Limits, the information of the belief that there is no change, and the
            largest size that is taken for warmth, shape (3, h); what is forgotten of
            that in a row; rows of motion after which an alarm is over.
        carried: Slow sums, shape (h, 2); evidence, shape (h, s); what sizes are made
            of and rows of motion since it was zero, shape (h, s, 3); all are changed.
            And the rows of motion until the last alarm is over.

    Returns:
        The evidence at each row, shape (m, h, s); rows with an alarm, shape (a,); the
        evidence and its parts there; and the rows until the last alarm is over.
    """
    z, u, moving = rows
    levels, decay, quiet = settings
    slow, g, sums, left = carried
    trace = np.empty((len(z), *g.shape))
    at = np.zeros(len(z), dtype=np.int64)
    seen, found = [g.copy()], [sums.copy()]
    count = 0
    for k in range(len(z)):
        for h in range(len(g)):
            usual = _usual(slow[h], levels[1, h], levels[2, h])
            over, under = _products(z[k], u[k], h)
            if under > 0.0:
                slow[h, 0] += over - decay * slow[h, 0]
                slow[h, 1] += under - decay * slow[h, 1]
                part = np.array([over - usual * under, under, moving[k]])
                _add(z[k], u[k], (h, usual, part), sizes[h], (g[h], sums[h]))
        trace[k] = g
        left = max(left - int(moving[k]), 0)
        if _crossed(g, levels[0]):
            if left == 0:
                at[count] = k
                count += 1
                seen.append(g.copy())
                found.append(sums.copy())
            left = quiet
            _start_anew(g, sums, levels[0])
    return trace, at[:count], seen[1:], found[1:], left


@numba.njit(cache=True)
def _usual(slow, prior, most):
    """Size that the last seconds of motion say, no more than healthy runs have.

    Warmth and the kind of motion change what a model leaves, too, but not at once.
    """
    size = slow[0] / (slow[1] + prior)
    return min(max(size, -most), most)


@numba.njit(cache=True)
def _of(h, dof):
    """First and last joint of a quantity, and which feature it is."""
    if h == 0:
        return 0, dof, 0
    return (h - 1) % dof, (h - 1) % dof + 1, 1 + (h - 1) // dof


@numba.njit(cache=True)
def _products(z, u, h):
    first, stop, c = _of(h, len(z))
    over, under = 0.0, 0.0
    for j in range(first, stop):
        over += z[j] * u[j, c]
        under += u[j, c] * u[j, c]
    return over, under


@numba.njit(cache=True)
def _huber(x):
    """Loss that grows with the square near zero, and not far from it."""
    x = abs(x)
    return 0.5 * x * x if x < CLIP else CLIP * (x - 0.5 * CLIP)


@numba.njit(cache=True)
def _add(z, u, quantity, sizes, into):
    """Add one row to the evidence for one quantity, in every size."""
    h, usual, part = quantity
    g, sums = into
    first, stop, c = _of(h, len(z))
    for s in range(len(sizes)):
        for j in range(first, stop):
            left = z[j] - usual * u[j, c]
            g[s] += _huber(left) - _huber(left - sizes[s] * u[j, c])
        if g[s] <= 0.0:
            g[s] = 0.0
            sums[s] = 0.0
        else:
            sums[s] += part


@numba.njit(cache=True)
def _crossed(g, limits):
    return np.any(g > limits.reshape(-1, 1))


@numba.njit(cache=True)
def _start_anew(g, sums, limits):
    for h in range(g.shape[0]):
        for s in range(g.shape[1]):
            if g[h, s] > limits[h]:
                g[h, s] = 0.0
                sums[h, s] = 0.0
