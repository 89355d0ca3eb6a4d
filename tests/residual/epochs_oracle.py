"""What one would reach who is told what changed: the measure of a comparison.

The same rows, nuisance and joint fit, but nothing is searched: names and joints are
given, their values are fitted together, each in its likeliest shape.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.diagnosis.oracle import Told, placed
from residual.epochs.compare import Asked, described, epoch_of, prepared
from residual.epochs.contrast import (
    Candidate,
    Table,
    refined,
    renewed,
    vocabulary,
    weighed,
)
from residual.epochs.models import augmented
from residual.epochs.rows import Both, beside, both_epochs
from residual.epochs.rules import Rules
from residual.epochs.search import WIDTHS, Change, Found
from residual.epochs.unrest import basics, first_noise, joints_of
from residual.evidence.columns import Group
from residual.model.compare import Errors, compare, prepare_held_out


def oracle(asked: Asked, effects: Sequence[Told]) -> Errors:
    """Fit the changes that one is told of, and predict the held-out logs.

    Args:
        effects: Name and joints, from 1, of each change.

    Raises:
        UnknownNameError: If there is no such effect.
    """
    places = [pair for told in effects for pair in placed(*told, asked.robot.dof)]
    keys = [(effect.name, joints) for effect, joints in places]
    logs, count, clocked = prepared(asked, Rules())
    nominal = described(logs, asked.declared)
    both = both_epochs(logs, count, nominal, Rules())
    groups, prices = vocabulary(both, clocked)
    found, every = _told(both, groups, groups, prices, keys)
    if found.changes:
        # As after a find: the joint fit, and what goes by the torque, see it.
        press = any(c.group.effect.carries == "body" for c in found.named)
        changed = [
            (c.contrast.candidate.group, c.contrast.theta) for c in found.changes
        ]
        both = beside(both, changed, press)
        seen = renewed(both, every) if press else groups
        found, _ = _told(both, seen, groups, prices, keys)
    first = epoch_of(asked, asked.first, nominal).model
    proof = prepare_held_out(asked.held_out, first)
    told = {"told": augmented(found, nominal, first).model}
    errors, _ = compare(told, proof, logs.filters)
    return errors["told"]


def _told(
    both: Both,
    groups: Sequence[Group],
    before: Sequence[Group],
    prices: Sequence[float],
    keys: Sequence[tuple],
) -> tuple[Found, list[Candidate]]:
    """Exactly these changes, and all candidates of which they are."""
    rest = joints_of(both, before)
    noise = first_noise(both, rest, basics(before))
    every = weighed(both.design, rest.joints, groups, prices, before)
    table = Table(rest.joints, both.blocks, noise)
    named: list[Candidate] = []
    for key in keys:
        alike = [c for c in every if c.key[:2] == key]
        if alike:
            named.append(_likeliest(both, table, alike, named))
    thetas = table.theta(named)
    changes = [
        Change(replace(table.contrast(c), theta=theta), 0.0, 0, (), 1.0)
        for c, theta in zip(named, thetas, strict=True)
    ]
    return Found(both, table, tuple(every), tuple(changes), rest.warmth), every


def _likeliest(
    both: Both, table: Table, alike: list[Candidate], named: Sequence[Candidate]
) -> Candidate:
    """The likeliest shape of one effect beside others, off the grid too."""

    def best(some: list[Candidate]) -> Candidate:
        return some[int(np.argmax(table.fits(some, named)))]

    out = best(alike)
    for width in WIDTHS if out.group.effect.refine else ():
        out = best([out, *refined(both, table.joints, out, width)])
    return out
