"""Groups, draws and bars of the benchmark of what changed."""

from dataclasses import dataclass

from benchmarks.attribution_parts import bars, cases
from residual.diagnosis.result import Detectable

ROW = {
    "arm": "six",
    "off": 3,
    "outcome": "exact",
    "planted": [["payload", [6]], ["coulomb", [2]]],
    "said": [[["payload", [6]]], [["coulomb", [2]]]],
    "true": 2,
    "exact": True,
    "listed": False,
    "unexplained": [],
    "moved_due": [["coulomb", 2]],
    "moved_told": [["coulomb", 2]],
    "moved_false": [],
}
FALSE = {
    "exact": False,
    "true": 1,
    "said": [[["payload", [6]]], [["offset", [1]]]],
    "moved_told": [],
}


def rows(good, bad, **wrong):
    return [ROW] * good + [{**ROW, **FALSE, **wrong}] * bad


def test_a_set_counts_if_it_is_exact_or_listed():
    found = bars.case_figures({"sets": rows(9, 1)}, deciding=True)
    assert found["rough_values_exact_or_listed"]["ok"] is True
    assert found["rough_values_exact_or_listed"]["per_name_missed"] == {"coulomb": 1}
    assert found["rough_values_names_true"]["value"] == 19 / 20
    assert found["rough_values_names_true"]["false"] == {"offset": 1}
    assert found["moved_told"]["value"] == 0.9
    assert found["moved_told"]["missed"] == {"coulomb": 1}
    listed = bars.case_figures({"sets": rows(1, 1, listed=True)}, deciding=True)
    assert listed["rough_values_exact_or_listed"]["value"] == 1.0
    exact = [row | {"off": 0} for row in rows(1, 1, listed=True)]
    found = bars.case_figures({"sets": exact}, deciding=True)
    assert found["exact_values_set_exact"]["value"] == 0.5
    few = bars.case_figures({"sets": rows(1, 9)}, deciding=False)
    assert few["rough_values_exact_or_listed"]["ok"] is None


def test_one_name_on_an_unchanged_arm_is_a_miss():
    quiet = {**ROW, "said": [], "planted": [], "true": 0}
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
