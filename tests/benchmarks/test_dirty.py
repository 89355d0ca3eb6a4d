"""Groups and bars of the benchmark on arms in use."""

import numpy as np

from benchmarks.dirty_parts import arms, bars, cases

ROW = {
    "outcome": "right",
    "data": "seven",
    "effect": "offset",
    "joints": [2],
    "multiple": 3.0,
    "named": 1,
    "found": 1,
    "extra": 0,
    "unexplained": [],
    "z": 0.5,
    "names": [["offset", [2], 50.0]],
    "classes": [[["offset", [2]]]],
    "seconds": 9.0,
    "drift": None,
    "drift_detectable": None,
    "background_names": [],
    "true_factor": 0.9,
}
DRIFT = {"factor": 0.92, "std": 0.015, "joints": [], "clock": "time"}


def rows(good, bad, **wrong):
    return [ROW] * good + [{**ROW, **wrong}] * bad


def test_one_alarm_in_fifty_passes_and_two_do_not():
    quiet = {"named": 0, "names": []}
    for alarms, ok in ((1, True), (2, False)):
        told = [{**ROW, **quiet}] * (50 - alarms) + [ROW] * alarms
        figures = bars.case_figures({"unchanged": told}, deciding=True)
        assert figures["unchanged_named"]["ok"] is ok
        assert figures["unchanged_named"]["names"] == {"offset": alarms}
    figures = bars.case_figures({"unchanged": told}, deciding=False)
    assert figures["unchanged_named"]["ok"] is None


def test_a_change_is_right_first_alone_and_of_its_size():
    beside = {"extra": 1, "classes": [*ROW["classes"], [["ripple", [4]]]], "z": 3.0}
    told = bars.case_figures({"change": rows(9, 1, **beside)}, deciding=True)
    assert told["change_right_first"]["value"] == 1.0
    assert told["change_false_beside"]["ok"] is False
    assert told["change_false_beside"]["names"] == {"ripple": 1}
    assert told["change_size_within_two_deviations"]["ok"] is True
    small = bars.case_figures({"change": rows(0, 5, multiple=1.5)}, deciding=True)
    assert small["change_too_small"]["value"] == 5
    assert small["change_right_first"]["ok"] is None


def test_drift_counts_where_it_is_told_the_right_way():
    said = [{**ROW, "drift": DRIFT}] * 9
    other = {**ROW, "drift": {**DRIFT, "factor": 1.08}}
    told = bars.case_figures({"drift": [*said, other]}, deciding=True)
    assert told["drift_told"]["ok"] is True
    assert told["drift_within_two_deviations"]["hits"] == 9
    nothing = bars.case_figures({"drift": rows(3, 0)}, deciding=True)
    assert nothing["drift_told"]["ok"] is False
    tiny = bars.case_figures({"drift": rows(0, 3, true_factor=1.001)}, deciding=True)
    assert tiny["drift_told"]["ok"] is None


def test_without_a_baseline_a_name_of_the_background_is_true():
    names = {"classes": [[["offset", [2]]], [["ripple", [5]]]], "named": 2}
    told = bars.case_figures({"alone": rows(0, 10, **names)}, deciding=True)
    assert told["alone_names_true"]["value"] == 1.0
    wrong = {"classes": [[["offset", [3]]]], "found": 0, "outcome": "wrong"}
    told = bars.case_figures({"alone": rows(9, 1, **wrong)}, deciding=True)
    assert told["alone_names_true"]["value"] == 0.9
    assert told["alone_names_true"]["false"] == {"offset": 1}
    assert told["alone_main_listed"]["value"] == 0.9


def test_time_is_compared_with_that_of_the_same_arm_clean():
    pairs = [({"seconds": 8.0}, {"seconds": s}) for s in (10.0, 11.0, 40.0)]
    assert bars.cost_figures(pairs, deciding=True)["cost_ratio"]["value"] == 11 / 8
    assert bars.cost_figures([], deciding=True)["cost_ratio"]["value"] is None


def test_groups_are_as_large_as_the_issue_asks_and_names_differ():
    seeds = range(1, 11)
    many = {group: cases.tasks(group, seeds, False) for group in cases.GROUPS}
    unchanged = [t.data for t in many["unchanged"]]
    counts = [unchanged.count(kind) for kind in ("pybullet", "seven", "other")]
    assert counts == [100, 50, 50]
    names = [t.name for tasks in many.values() for t in tasks]
    assert len(set(names)) == len(names)
    benches = {b.name for b in cases.benches([t for ts in many.values() for t in ts])}
    assert {t.bench for t in many["change"]} <= benches


def test_a_bench_is_the_same_arm_in_other_noise():
    task = cases.tasks("change", range(1, 2), True)[0]
    bench = cases.benches([task])[0]
    one, other = (
        arms.make(arms.Arm(t.data, t.background, t.arm, t.noise), (), arms.AGAINST)
        for t in (task, bench)
    )
    for a, b in zip(one.baseline, other.baseline, strict=True):
        assert np.abs(a.q - b.q).max() < 2e-3  # the same motion
        assert not np.array_equal(a.tau, b.tau)
        assert (a.tau - b.tau).std() < 0.05 * a.tau.std()
    assert one.factor == other.factor
    assert one.fit[0].t[0] > one.baseline[-1].t[-1]
    assert [log.id for log in one.baseline] != [log.id for log in one.fit]
