"""Held-out logs are read once, after every choice."""

from dataclasses import replace
from functools import cache

import pytest

from sim.engine.plant_records import SyntheticEffect
from tests.residual.arms import arm, diagnose_case, short_case

HIDDEN = (
    SyntheticEffect("quadratic_viscous", (1,), {"coefficient": 4.0}),
    SyntheticEffect("warmup", (2,), {"level": 3.0, "time_constant": 40.0}),
)


@cache
def case(*hidden, seed=71):
    return short_case(arm(), *hidden, seed=seed, duration=8.0)


@cache
def before_the_proof(held_out) -> set[tuple[str, int, float]]:
    """Each name on each joint with its probability, wherever the proof puts it."""
    verdict = diagnose_case(case(*HIDDEN), held_out=held_out).verdict
    places = (*verdict.effects, *verdict.suspected, *verdict.background)
    return {(e.name, j, e.probability) for e in places for j in e.joints or (0,)}


@pytest.mark.parametrize(
    "held_out",
    [
        # Another motion of the same arm, recorded before the logs to fit.
        [replace(r, t=r.t - r.t[0] - 500.0) for r in case(*HIDDEN, seed=72).held_out],
        # An arm that has none of the effects: the proof refutes what is named.
        case(seed=71).held_out,
    ],
    ids=["another motion", "another arm"],
)
def test_names_and_probabilities_are_of_the_logs_to_fit_alone(held_out):
    names = before_the_proof(case(*HIDDEN).held_out)
    assert {"quadratic_viscous"} <= {name for name, _, _ in names}
    assert before_the_proof(tuple(held_out)) == names
