"""Cases and bars of the diagnosis benchmark, and results that outlive a kill."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.diagnosis_parts import bars, cases
from benchmarks.harness.cases import run_kept
from benchmarks.hidden import sized
from benchmarks.hidden.sized import CLEAR, SHARES, draw_of_share
from benchmarks.synthetic.visible import share
from flows.workers import InlineExecutor
from residual.diagnosis.diagnose import diagnose
from sim.engine.plant_records import create_random_stream

ROW = {
    "outcome": "right",
    "data": "synthetic",
    "hides": "offset",
    "effect": "offset",
    "joints": [2],
    "second": None,
    "share": 0.05,
    "named": 1,
    "found": 1,
    "extra": 0,
    "joint_right": True,
    "unexplained": [],
    "error_after": 4.4,
    "error_oracle": 4.0,
    "deviations": [["offset", 0.5]],
    "names": [],
    "seconds": 1.0,
}


def _rows(good, bad, **wrong):
    return [ROW] * good + [{**ROW, **wrong}] * bad


def _task(group, hides, share=None):
    return cases.Task(group, hides, "quick", motion=1, arm=2, share=share)


@pytest.mark.parametrize(
    ("group", "hides", "sizes"),
    [
        ("singles", "stribeck", [0.05]),
        ("singles", "encoder_offset", [0.01]),
        ("singles", "presliding", [None]),
        ("forms", "cubic_cable", CLEAR),
        ("pairs", "", CLEAR),
    ],
)
def test_what_is_hidden_has_its_share(group, hides, sizes, monkeypatch):
    def refuse(*args, **options):
        raise AssertionError("a diagnosis has no part in what is hidden")

    monkeypatch.setattr(cases, "diagnose", refuse)
    task = _task(group, hides, sizes[0] if group == "singles" else None)
    _, effects, shares = cases.hidden(task)
    assert len(effects) == (2 if group == "pairs" else 1)
    stages = cases._stages(task.data, task.motion)
    for effect, size in zip(effects, shares, strict=True):
        arm_has = cases.as_form(effect, hides) if group == "forms" else effect
        assert size is None or size in sizes
        if size is not None:
            got = share(cases.the_arm(), arm_has, stages)
            assert got == pytest.approx(size, rel=0.02)


def test_the_seed_of_the_arm_says_what_it_hides_and_the_same_twice():
    task = _task("singles", "presliding")
    assert cases.hidden(task) == cases.hidden(task)
    assert cases.hidden(task)[1] != cases.hidden(replace(task, arm=3))[1]


def test_a_share_is_rms_of_torque_over_that_of_the_joint():
    stages, rng = cases._stages("quick", 1), create_random_stream(1, "rms")
    effect, _ = draw_of_share(cases.the_arm(), rng, "offset", [0.1], stages)
    (joint,) = effect.joints
    moving, torque = (
        np.concatenate([getattr(stage, key)[:, joint - 1] for stage in stages])
        for key in ("moves", "torque")
    )
    rms = np.sqrt(np.mean(torque[moving] ** 2))
    assert abs(dict(effect.parameters)["torque"]) == pytest.approx(0.1 * rms, rel=0.02)


def test_more_than_an_arm_has_is_left_out_without_a_diagnosis(monkeypatch):
    monkeypatch.setattr(sized, "_TRIES", 2)
    row = cases.run(_task("singles", "elasticity", 100.0))
    assert row["left_out"]
    figures = bars.case_figures({"singles": [row, ROW]}, deciding=True)
    assert figures["singles_more_than_an_arm_has"]["value"] == 1
    assert figures["singles_of_5_right"]["n"] == 1


def test_a_seed_has_every_effect_at_every_size_and_needs_no_detectable_ones():
    tasks = cases.tasks("singles", range(1, 3), quick=False)
    assert tasks == cases.tasks("singles", range(1, 3), quick=False)
    sizes = [(task.arm, task.share) for task in tasks if task.hides == "offset"]
    assert sizes == [*((1, share) for share in SHARES), *((2, x) for x in CLEAR)]
    assert [t.share for t in tasks if t.hides == "presliding"] == [None, None]


def test_singles_are_counted_by_size_and_the_small_ones_have_no_bar():
    rows = _rows(95, 5, outcome="nothing", named=0, deviations=[])
    rows += _rows(0, 7, outcome="nothing", named=0, deviations=[], share=0.01)
    figures = bars.case_figures({"singles": rows}, deciding=True)
    small = figures["singles_of_1_right"]
    assert (small["value"], small["n"], small["ok"]) == (0.0, 7, None)
    one = figures["singles_of_5_right"]
    assert (one["value"], one["n"], one["ok"]) == (0.95, 100, True)
    assert figures["named_right"]["ok"] is None  # fewer than 300 names
    assert figures["error_over_oracle"]["ok"] is True
    assert figures["coverage_2_sigma"]["ok"] is False  # too wide is wrong as well


def test_results_are_kept_line_by_line_and_a_torn_one_is_done_again(tmp_path, capsys):
    path, numbers = tmp_path / "kept.jsonl", []

    def work(number):
        numbers.append(number)
        if number == 3:
            raise ValueError("no")
        return {"number": number}

    jobs = {"one": 1, "two": 2, "three": 3}
    first = run_kept(path, str, work, jobs, InlineExecutor())
    assert first["three"] == {"error": "ValueError: no"}
    path.write_text(path.read_text()[:-9])  # killed within the last line
    numbers.clear()
    again = run_kept(path, str, work, jobs, InlineExecutor())
    assert numbers == [2, 3]
    assert again["one"] == {"number": 1}
    run_kept(path, str, work, {"one": 1, "two": 2}, InlineExecutor())
    assert numbers == [2, 3]


@pytest.mark.long
def test_of_an_arm_whose_bodies_are_all_a_little_off_no_single_one_is_named():
    """As likely as exact bodies and one that is off are bodies that all are."""
    made = cases.make("synthetic", [], 640416, 640416)
    assert diagnose(made.robot, made.fit, (), made.held_out).verdict.effects == ()
