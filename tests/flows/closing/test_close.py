"""A loop that is killed goes on where it stopped, and ends as it would have ended."""

from dataclasses import replace
from functools import partial

import pytest

from flows.steps.closing import close
from flows.steps.closing.arm import Close, loop_id, make_arm
from residual.errors import InputError
from tests.flows.closing import scripted
from warehouse.layout import Found, list_folders
from warehouse.numbered import commit_decision, read_decisions
from warehouse.query.store import open_store
from warehouse.verify import faults


class KilledError(Exception):
    """In place of a kill."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The decisions of a loop that nobody disturbs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(close, "act", scripted.act)
        return scripted.play(tmp_path_factory.mktemp("whole"))


def test_the_script_comes_to_its_end(whole):
    actions = [d.action for d in whole]
    assert actions.count("adopt") == 1
    assert actions[-1] == "stop"
    assert whole[-1].result["why"] == "nothing left"
    assert [d.number for d in whole] == list(range(1, len(whole) + 1))
    assert whole[-1].seconds == 20.0 * actions.count("run")


@pytest.mark.parametrize("after", [False, True])
def test_killed_at_any_decision_it_goes_on_to_the_same_end(
    tmp_path, monkeypatch, whole, after
):
    killed = set()

    def doomed(loop, step, tell=None):
        number = len(loop.history) + 1
        came = scripted.act(loop, step) if after else None
        if number not in killed:
            killed.add(number)
            raise KilledError
        return came or scripted.act(loop, step)

    monkeypatch.setattr(close, "act", doomed)
    for _ in whole:
        with pytest.raises(KilledError):
            scripted.play(tmp_path)
    assert len(scripted.play(tmp_path)) == 1
    loop = whole[0].loop
    assert read_decisions(tmp_path, loop) == tuple(whole)
    assert scripted.play(tmp_path) == []


def test_decisions_are_records_in_sql_and_a_number_is_taken_once(tmp_path, whole):
    for decision in whole:
        commit_decision(tmp_path, decision)
    with pytest.raises(InputError, match="runs in another process"):
        commit_decision(tmp_path, replace(whole[2], reason="another"))
    for id, folder in list_folders(tmp_path, "decisions").items():
        assert faults(Found("decisions", id, type(tmp_path)(folder))) == ()
    with open_store(tmp_path) as opened:
        asked = "SELECT number, action, reason FROM decisions ORDER BY number"
        rows = opened.sql(asked).to_pylist()
    assert [(r["number"], r["action"], r["reason"]) for r in rows] == [
        (d.number, d.action, d.reason) for d in whole
    ]


def test_a_larger_budget_goes_on_with_the_same_loop(tmp_path, monkeypatch):
    quiet = partial(scripted.act, script=(scripted.QUIET,))
    monkeypatch.setattr(close, "act", quiet)
    short = scripted.play(tmp_path, budget=3)
    assert short[-1].result["why"] == "nothing left"
    spent = partial(scripted.act, script=(scripted.QUIET | {"verdict": "unknown"},))
    monkeypatch.setattr(close, "act", spent)
    other = tmp_path / "other"
    assert scripted.play(other, budget=3)[-1].result["why"] == "budget"
    more = scripted.play(other, budget=4)
    assert [d.action for d in more] == ["run", "diagnose", "stop"]


def test_an_arm_has_a_serial_number_and_is_the_same_every_time(tmp_path):
    asked = Close("irb140", seed=3, store=tmp_path)
    one, again = make_arm(asked, tmp_path), make_arm(asked, tmp_path)
    assert (one.robot.serial, one.seal) == ("close-3", again.seal)
    assert 1 <= len(one.plant["effect"]) <= 3
    other = make_arm(replace(asked, seed=4), tmp_path)
    assert other.seal != one.seal
    assert loop_id(asked, one) == loop_id(replace(asked, budget=99), again)
    exact = make_arm(replace(asked, effects=2), tmp_path)
    assert len(exact.plant["effect"]) == 2
    assert make_arm(replace(asked, effects=0), tmp_path).plant["effect"] == []


def test_records_of_another_arm_are_not_gone_on_with(tmp_path, monkeypatch, whole):
    wrong = replace(whole[0], result={**whole[0].result, "seal": "0" * 64})
    commit_decision(tmp_path, wrong)
    monkeypatch.setattr(close, "act", scripted.act)
    with pytest.raises(InputError, match="draws another arm"):
        scripted.play(tmp_path)
