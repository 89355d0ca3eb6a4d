"""Cases, sizes, peer and bars of the benchmark of what changed."""

import sys
from dataclasses import asdict, replace
from importlib import util
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.changes_parts import arms, ask, bars, cases, peer, plant
from benchmarks.changes_parts.added import rigid_body, shares, size_of, solved
from benchmarks.changes_parts.ask import Answer, Said, judged, make
from benchmarks.changes_parts.case import (
    CHANGE,
    LOAD,
    REAL_CHANGE,
    Planted,
    Truth,
    from_json,
)
from benchmarks.harness.origin import ROOT
from benchmarks.measured_parts.arms import UR10E, absent
from flows.blind.score import Name
from residual.recording import Recording
from residual.robot.robot import load_robot

SKETCH = ROOT.parent / "shared" / "prototypes" / "two_epochs.py"


@pytest.fixture(autouse=True)
def _apart(tmp_path, monkeypatch):
    """Keep the list of these tests out of the store."""
    monkeypatch.setattr(cases, "_path", lambda: tmp_path / "listed.jsonl")


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


def test_a_committed_list_is_taken_as_it_is(tmp_path, monkeypatch):
    slot = cases._quick(CHANGE, 1)[0]
    record = cases.drawn(slot) | {"noise": 77}
    monkeypatch.setattr(cases, "_committed", lambda: {slot.name: record})
    assert cases.listed(CHANGE, range(1, 2), quick=True)[0].noise == 77
    drawn_again = cases.listed(CHANGE, range(1, 2), quick=True, committed=False)
    assert drawn_again[0].noise != 77


def test_a_planted_offset_has_the_size_that_was_asked_for():
    case = _case("offset", 0.05)
    (joint,) = case.planted[0].joints
    torque = dict(case.planted[0].parameters)["torque"]
    model = arms.truly(case)
    logs = arms.record(replace(case, held_out=()), arms.SECOND, (), exact=True)
    tau = []
    for log in logs:  # the formula again, by hand and without the filter
        speed = np.abs(np.gradient(log.q[:, joint - 1], log.t))
        inside = (log.t > log.t[0] + 0.6) & (log.t < log.t[-1] - 0.6)
        tau.append(
            log.tau[inside & (speed > 0.03 * np.quantile(speed, 0.95)), joint - 1]
        )
    rms = np.sqrt(np.mean(np.concatenate(tau) ** 2))
    reported = abs(torque) * model.reported[joint - 1]
    assert reported / rms == pytest.approx(0.05, rel=0.05)


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


def test_a_size_that_no_arm_can_have_is_none():
    assert solved(lambda factor: 0.02 * factor**1.5, 0.1)[1] == pytest.approx(
        0.1, rel=0.02
    )
    assert solved(lambda factor: None if factor > 2 else 0.02 * factor, 0.1) is None
    assert solved(lambda factor: 0.0, 0.1) is None
    case = from_json(cases.drawn(cases.Slot("unchanged", 3, 0, 0.0, "six")))
    rng = np.random.default_rng(1)
    assert plant.drawn(case, "delay", rng, 5.0) is None


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


def test_the_edge_is_what_the_program_says_of_the_same_arm():
    one = Planted("elasticity", (2,), (("stiffness", 4e4),))
    plain = from_json(cases.drawn(cases.Slot("edge", 1, 0, 0.0, "six")))
    case = replace(plain, planted=(one,))

    def least(joint, value):
        return {
            "name": "elasticity",
            "joints": [joint],
            "value": value,
            "unit": "N m/rad",
        }

    minimum = [least(1, 9e9), least(2, 1.5e4)]
    sized = ask._at_the_edge(case, minimum)
    assert dict(sized.planted[0].parameters)["stiffness"] == pytest.approx(1.5e4)
    assert sized.name == case.name
    assert ask._at_the_edge(case, [least(2, None)]) is None


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


def test_a_change_without_a_name_counts_by_its_flag():
    truth = (Truth("x_wall", (3,), {"stiffness": 9.0}, 0.1),)
    of = {"group": "unnamed", "effect": "x_wall"}
    flagged = Answer((), (3,), 1.0)
    rows = [_row(flagged, i, truth, **of) for i in range(9)]
    rows.append(_row(Answer((Said(Name("spring", (3,))),), (2,), 1.0), 9, truth, **of))
    told = bars.all_figures(rows, deciding=True)
    assert told["unnamed_flagged"]["value"] == 0.9
    assert told["unnamed_named"]["names"] == {"spring": 1}


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


def test_a_load_that_is_not_named_is_missed():
    truth = (Truth("payload", (6,), {"mass": 2.805}, 0.0),)
    said = Said(Name("payload", (6,)), (), {"mass": (2.9, 0.1)})
    of = {"group": LOAD, "arm": "ur10e", "target": 0.0, "effect": "payload"}
    rows = [_row(Answer((said,), (), 2.0), 0, truth, **of)]
    rows.append(_row(SILENT, 1, truth, **of))
    told = bars.all_figures(rows, deciding=True)
    assert told["load_feb19"]["ok"] is True
    assert told["load_feb12_feb19"]["ok"] is False


def _small(robot, seed, shift):
    """Return 25 s of an arm whose second joint has an offset or none."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 25.0, 0.02)
    rates = rng.uniform(0.5, 2.0, (robot.dof, 3))
    q = sum(
        np.sin(np.outer(t, rates[:, i]) + rng.uniform(0, 6, robot.dof)) / (i + 2)
        for i in range(3)
    )
    qd, qdd = (np.gradient(x, t, axis=0) for x in (q, np.gradient(q, t, axis=0)))
    tau = rigid_body(robot.model)(q, qd, qdd) + 3.0 * np.tanh(qd / 0.02)
    tau += 0.5 * rng.normal(size=tau.shape)
    tau[:, 1] += shift
    return Recording(f"log_{seed}", robot.name, t, q, tau)


def _sketch():
    spec = util.spec_from_file_location("two_epochs", SKETCH)
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _write(folder, name, log):
    kinds = (("q", log.q), ("tau", log.tau))
    heads = [f"{kind}{i + 1}" for kind, _ in kinds for i in range(log.dof)]
    rows = np.column_stack([log.t, log.q, log.tau])
    head = ",".join(["t", *heads])
    np.savetxt(
        folder / name, rows, delimiter=",", header=head, comments="", fmt="%.17g"
    )


@pytest.mark.skipif(not SKETCH.exists(), reason="no ../shared with the sketch")
def test_the_peer_is_the_sketch(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    robot = load_robot("irb140")
    first = [_small(robot, seed, 0.0) for seed in (1, 2)]
    second = [_small(robot, 3, 6.0)]
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "robot.urdf").write_text(robot.urdf, encoding="utf-8")
    for i, log in enumerate(first):
        _write(tmp_path, f"base{i}.csv", log)
    _write(tmp_path, "new0.csv", second[0])
    theirs, their_factors = _sketch().changes(str(tmp_path))
    mine, factors = peer.changes(robot.model, first, second)
    assert factors == pytest.approx(np.array(their_factors), rel=1e-6)
    assert mine[0].found
    assert (mine[0].name, mine[0].joint) == ("offset", 2)
    assert len(mine) == len(theirs)
    ordered = {(name, joint): [] for _, name, joint, *_ in theirs}
    for change in mine:
        ordered[change.name, change.joint].append(change)
    for nats, name, joint, estimate, deviation, share in theirs:
        change = ordered[name, joint].pop(0)
        assert change.evidence == pytest.approx(nats, rel=1e-6, abs=1e-6)
        assert change.estimate == pytest.approx(estimate, rel=1e-6, abs=1e-9)
        assert change.deviation == pytest.approx(deviation, rel=1e-6, abs=1e-9)
        assert change.share == pytest.approx(share, rel=1e-6, abs=1e-9)
    assert all(a.evidence >= b.evidence for a, b in pairwise(mine))


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
