"""A results file whose groups were measured one by one, and what measures them."""

from importlib import import_module
from pathlib import Path

import pytest

from benchmarks.bench import PLAN
from benchmarks.harness.figures import (
    figure,
    finish,
    function_of,
    missing,
    partial,
)


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
