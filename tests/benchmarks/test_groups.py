"""A results file whose groups were measured one by one, and what measures them."""

from importlib import import_module
from pathlib import Path

import pytest

from benchmarks.bench import PLAN
from benchmarks.harness.figures import (
    figure,
    finish,
    function_of,
    merged,
    missing,
    partial,
)

GROUPS = ("one", "two", "three")


def about(commit):
    keys = ("dirty", "code", "date", "cores", "quick")
    return {"commit": commit, **dict.fromkeys(keys, 0)}


def test_groups_measured_now_take_the_place_of_their_old_figures_and_no_others():
    first = merged({}, {"two": {"b": 1, "gone": 2}}, about("aa"), GROUPS)
    second = merged(first, {"one": {"a": 3}}, about("bb"), GROUPS)
    assert list(second["figures"].items()) == [("a", 3), ("b", 1), ("gone", 2)]
    assert [(k, v["commit"]) for k, v in second["by_group"].items()] == [
        ("one", "bb"),
        ("two", "aa"),
    ]
    third = merged(second, {"two": {"b": 4}}, about("cc"), GROUPS)
    assert third["figures"] == {"a": 3, "b": 4}
    assert {k: v["commit"] for k, v in third["by_group"].items()} == {
        "one": "bb",
        "two": "cc",
    }


def test_the_exit_code_is_one_for_a_missed_bar_only(capsys):
    assert finish({"a": figure(1.0, 2.0, 3), "b": missing(1.0, "no data")}) == 0
    small = partial(figure(0.0, 1.0, 2), "too few")
    assert small["ok"] is None
    assert finish({"a": small}) == 0
    assert finish({"a": partial(figure(3.0, 1.0, 2), "too few")}) == 1
    assert capsys.readouterr().out.strip().splitlines()[-1].startswith("{")


@pytest.mark.long
@pytest.mark.parametrize("name", PLAN)
def test_what_a_run_of_all_starts_can_be_loaded(name):
    """What it imports of the program, groups that are loaded late among it."""
    path = Path(PLAN[name][0]).stem
    module = import_module(f"benchmarks.{path}")
    groups = getattr(module, "GROUPS", ())
    if path == "groups":
        groups = groups[name]
    for place in groups.values() if isinstance(groups, dict) else ():
        assert callable(function_of(place))
