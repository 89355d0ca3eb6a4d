"""Cases, sizes, peer and bars of the benchmark of what changed."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from benchmarks.changes_parts import arms, ask, bars, cases, plant
from benchmarks.changes_parts.added import rigid_body, shares, size_of
from benchmarks.changes_parts.ask import Answer, Said, judged, make
from benchmarks.changes_parts.case import (
    CHANGE,
    REAL_CHANGE,
    Truth,
    from_json,
)
from benchmarks.hidden.score import Name
from benchmarks.measured_parts.arms import UR10E, absent


@pytest.fixture(autouse=True)
def _apart(tmp_path, monkeypatch):
    """Keep the list of these tests out of the store."""
    monkeypatch.setattr("benchmarks.harness.cases.STORE", tmp_path)


def _case(effect, size, seed=3):
    """Return a listed case of a six-joint arm with that change."""
    slot = cases.Slot(CHANGE, seed, 0, size, "six")
    plain = from_json(cases.drawn(cases.Slot("unchanged", seed, 0, 0.0, "six")))
    rng = np.random.default_rng(seed)
    tries = (plant.drawn(plain, effect, rng, slot.target) for _ in range(20))
    planted = next(one for one in tries if one is not None)
    return replace(plain, planted=(planted,), target=size)


def test_a_list_is_the_same_whenever_it_is_made():
    slot = cases.Slot(CHANGE, 1, 0, 0.05, "six")
    one, other = cases.drawn(slot), cases.drawn(slot)
    assert one == other
    assert asdict(from_json(one)) == one
    assert abs(one["planted"][0]["size"] / 0.05 - 1) < 0.02


@pytest.mark.parametrize("effect", ["payload", "encoder_offset", "delay"])
def test_a_planted_change_has_its_size_in_the_logs_that_are_made(effect):
    case = _case(effect, 0.10)
    model, one = arms.truly(case).model, case.planted[0]
    changed, plain = (
        arms.record(replace(case, held_out=()), arms.SECOND, effects, exact=True)
        for effects in ((plant.as_effect(one),), ())
    )
    pairs = zip(changed, plain, strict=True)
    found = [shares(rigid_body(model), *pair) for pair in pairs]
    assert size_of(found, one.joints) == pytest.approx(0.10, rel=0.05)
    made = make(case)
    assert made.truth[0].name == effect
    assert made.second[0].t[0] > made.first[-1].t[-1]
    assert len(made.held_out) == 1
    # Noise and nothing else lies between what was made and what was measured.
    left = made.second[0].tau - changed[0].tau
    assert left.std() < 0.1 * changed[0].tau.std()


TRUTH = (Truth("offset", (2,), {"torque": 4.0}, 0.1),)
ROW = {
    "method": ask.PRODUCT,
    "group": CHANGE,
    "seed": 1,
    "arm": "seven",
    "background": "workshop",
    "target": 0.1,
    "effect": "offset",
    "size": 0.1,
}


def _row(answer, index=0, truth=TRUTH, **other):
    return {**ROW, "index": index, **judged(truth, answer), **other}


RIGHT = Answer((Said(Name("offset", (2,)), (), {"torque": (4.1, 0.1)}),), (), 3.0)
SILENT = Answer((), (), 3.0)


def test_silence_and_a_crash_are_misses():
    crash = _row(SILENT, 2, error="ValueError: no")
    rows = [_row(RIGHT), _row(SILENT, 1), crash]
    told = bars.all_figures(rows, deciding=True)
    entry = told["change_10_right_first"]
    assert (entry["value"], entry["n"], entry["ok"]) == (1 / 3, 3, False)
    assert told["change_10_nothing_else"]["n"] == 1
    assert told["crashes"]["ok"] is False
    assert told["change_within_two_deviations"]["value"] == 1.0
    assert bars.all_figures(rows, deciding=False)["change_10_right_first"]["ok"] is None


def test_another_name_is_right_only_where_the_answer_says_that_it_may_be():
    other, its = Name("coulomb_asymmetry", (2,)), Name("offset", (2,))
    alone = judged(TRUTH, Answer((Said(other),), (), 1.0))
    assert not alone["right_first"]
    assert alone["extra"] == ["coulomb_asymmetry"]
    of_class = judged(TRUTH, Answer((Said(other, (its,)),), (), 1.0))
    assert of_class["right_first"]
    assert not of_class["by_name"]
    assert of_class["extra"] == []
    elsewhere = judged(TRUTH, Answer((Said(Name("offset", (3,))),), (), 1.0))
    assert not elsewhere["right_first"]
    second = judged(TRUTH, Answer((Said(other), Said(its)), (), 1.0))
    assert not second["right_first"]
    assert second["found"] == 1


def test_the_peer_is_compared_on_the_same_cases():
    mine = [_row(RIGHT if i < 6 else SILENT, i) for i in range(8)]
    its = [_row(RIGHT if i in (0, 7) else SILENT, i, method="peer") for i in range(8)]
    told = bars.all_figures([*mine, *its], deciding=True)["change_10_over_peer"]
    assert told["alone"] == [5, 1]
    assert told["value"] == 0.5
    assert told["ok"] is True
    assert told["p"] == pytest.approx(2 * 7 / 64, abs=1e-4)
    worse = [
        r | {"method": ask.PEER if r["method"] == ask.PRODUCT else ask.PRODUCT}
        for r in (*mine, *its)
    ]
    assert bars.all_figures(worse, deciding=True)["change_10_over_peer"]["ok"] is False


@pytest.mark.skipif(absent(UR10E), reason="no measured logs of the UR10e")
def test_a_change_added_to_measured_logs_is_of_its_size_and_not_in_the_first_epoch():
    slot = cases.Slot(REAL_CHANGE, 1, 0, 0.10, UR10E)
    case = from_json(cases.drawn(slot))
    assert case.planted[0].size == pytest.approx(0.10, rel=0.02)
    plain = make(replace(case, planted=()))
    made = make(case)
    for log, other in zip(made.first, plain.first, strict=True):
        assert np.array_equal(log.tau, other.tau)
    moved = [
        np.abs(a.tau - b.tau).max() + np.abs(a.q - b.q).max()
        for a, b in zip(made.second, plain.second, strict=True)
    ]
    assert min(moved) > 0
    assert made.held_out == ()
    days = {part.what for part in case.first}
    assert days.isdisjoint(part.what for part in case.second)
    for epoch in (case.first, case.second):
        assert 19.0 <= sum(part.duration for part in epoch) <= 51.0
