"""Groups, draws and bars of the benchmark of what changed."""

from dataclasses import dataclass

from benchmarks.attribution_parts import bars, cases
from benchmarks.attribution_parts.arms import (
    Arm,
    make,
)
from benchmarks.attribution_parts.cases import true_arm
from residual.diagnosis.result import Detectable
from residual.model.nominal import prepare_logs, start_nominal
from residual.signals.track import Filters
from residual.verdict.edit import MOVING, errors_on
from sim.engine.records import PlantEffect

ROW = {
    "arm": "six",
    "off": 3,
    "count": 2,
    "outcome": "exact",
    "planted": [["payload", [6], {}, 4.0], ["coulomb", [2], {}, 3.5]],
    "said": [[["payload", [6]]], [["coulomb", [2]]]],
    "true": 2,
    "exact": True,
    "exact_by_name": True,
    "listed": False,
    "unexplained": [],
    "moved_due": [["coulomb", 2]],
    "moved_told": [["coulomb", 2]],
    "moved_false": [],
    "edits": [],
}
FALSE = {
    "exact": False,
    "exact_by_name": False,
    "true": 1,
    "said": [[["payload", [6]]], [["offset", [1]]]],
    "moved_told": [],
}


def rows(good, bad, **wrong):
    return [ROW] * good + [{**ROW, **FALSE, **wrong}] * bad


def test_a_set_counts_if_it_is_exact_or_listed():
    told = bars.case_figures({"changed": rows(9, 1)}, deciding=True)
    assert told["set_exact_or_listed"]["ok"] is True
    assert told["set_exact_or_listed"]["per_name_missed"] == {"coulomb": 1}
    assert told["precision"]["value"] == 19 / 20
    assert told["precision"]["ok"] is False
    assert told["precision"]["false"] == {"offset": 1}
    assert told["moved_told"]["value"] == 0.9
    assert told["moved_told"]["missed"] == {"coulomb": 1}
    listed = bars.case_figures({"changed": rows(1, 1, listed=True)}, deciding=True)
    assert listed["set_exact_or_listed"]["value"] == 1.0
    assert listed["precision"]["value"] == 1.0
    assert listed["precision_first_set"]["value"] == 0.75
    few = bars.case_figures({"changed": rows(1, 9)}, deciding=False)
    assert few["set_exact_or_listed"]["ok"] is None


def test_one_name_on_an_unchanged_arm_is_a_miss():
    quiet = {**ROW, "said": [], "planted": [], "count": 0, "true": 0}
    good = bars.case_figures({"unchanged": [quiet] * 3}, deciding=True)
    assert good["unchanged_named"]["ok"] is True
    loud = bars.case_figures({"unchanged": [quiet, ROW]}, deciding=True)
    assert loud["unchanged_named"]["ok"] is False
    assert loud["unchanged_named"]["names"] == {"payload": 1, "coulomb": 1}


@dataclass(frozen=True)
class Told:
    """What of a verdict is judged here."""

    changes: tuple


def test_a_value_is_due_beyond_its_detectable_size_and_five_per_cent(monkeypatch):
    entry = {"joints": [2], "beyond": True}
    told = [
        {"name": "coulomb", **entry},
        {"name": "coulomb", **entry, "joints": [3]},
        {"name": "viscous", **entry, "beyond": False},
    ]
    monkeypatch.setattr(cases, "to_json", lambda verdict: {"changes": verdict.changes})
    # As a kept row has them: lists, not tuples.
    sizes = [
        Detectable(name, [j], 0.5, "")
        for name in ("coulomb", "viscous")
        for j in (1, 2, 3)
    ]
    values = {
        ("coulomb", 1): (4.0, 4.4),  # not detectable
        ("coulomb", 2): (4.0, 5.0),
        ("coulomb", 3): (40.0, 40.6),  # under 5 %
        ("viscous", 2): (4.0, 5.0),
        ("viscous", 9): (4.0, 9.0),  # of no known size
    }
    found = cases.moved(Told(told), values, sizes, True)
    assert found["moved_due"] == [["coulomb", 2], ["viscous", 2], ["body", 0]]
    assert found["moved_told"] == [["coulomb", 2]]
    assert found["moved_false"] == [["coulomb", 3]]
    told.append({"name": "inertial", "joints": [4], "beyond": True})
    assert ["body", 0] in cases.moved(Told(told), values, sizes, True)["moved_told"]


def test_the_true_arm_predicts_its_own_log():
    arm = Arm("six", 0.1, 5, 6, True)
    drawn = [
        PlantEffect("coulomb", (2,), (("level", 5.0),)),
        PlantEffect("offset", (3,), (("torque", 2.0),)),
        PlantEffect("link_inertia", (2,), (("scale", 0.3),)),
    ]
    made = make(arm, drawn)
    logs = prepare_logs(arm.robot, made.fit, None, Filters())
    nominal = start_nominal(logs, tuple(arm.robot.declared)).model
    errors = errors_on(
        {"true": true_arm(arm, drawn, nominal), "nominal": nominal},
        made.held_out,
        MOVING,
    )
    assert errors["true"] < 1.0
    assert errors["nominal"] > 3 * errors["true"]
