"""The page and the words of a loop that has ended."""

from dataclasses import replace

import pytest

from flows.report.closed import FALSE, MISSED, RIGHT, headline, pairs, render
from flows.steps.closing import close
from flows.steps.closing.close import begun, summary
from residual.diagnosis.result import (
    MOTION,
    Alternative,
    Evidence,
    Finding,
    Parameter,
    Place,
)
from tests.flows.closing import scripted
from tests.flows.report_outcomes import one_effect

SPRING = {"name": "spring", "joints": [3], "parameters": {"stiffness": 4.4}}


def _named(name, joints, *equivalent):
    evidence = Evidence(50.0, "fit", "confirmed", 0.5, None)
    known = {"stiffness": Parameter(4.1, 0.1, "N m/rad")}
    return Finding(name, joints, 0.99, 1, equivalent, known, evidence)


def _verdict(*effects, **more):
    return replace(one_effect().verdict, effects=effects, **more)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A loop of the script, with a spring under the seal."""
    store = tmp_path_factory.mktemp("store")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(close, "act", scripted.act)
        made = scripted.play(store)
    loop = begun(close.Close("irb140", 6, 1, 1, store=store))
    return close.Closed(loop.id, loop.arm, tuple(made), (SPRING,))


def test_what_was_hidden_is_held_against_what_was_adopted(done):
    verdict = _verdict(_named("spring", (3,)))
    (pair,) = pairs(done.hidden, verdict)
    assert (pair.judged, pair.right) == (RIGHT, True)
    assert "4.4 N m/rad" in pair.values
    near = _verdict(_named("balancer", (3,), Place("spring", (3,))))
    assert pairs(done.hidden, near)[0].right
    wrong = pairs(done.hidden, _verdict(_named("offset", (6,))))
    assert [p.judged for p in wrong] == [MISSED, FALSE]
    assert "0 of 1" in headline(done, wrong)
    assert "not there" in headline(done, wrong)
    assert [p.judged for p in pairs(done.hidden, None)] == [MISSED]


def test_the_page_has_every_decision_and_needs_nothing_else(done):
    page = render(done, _verdict(_named("spring", (3,))))
    for decision in done.decisions:
        assert decision.outcome in page.lower()
    assert page.count("<tr>") >= len(done.decisions)
    assert "1 of 1 hidden effects adopted" in page
    assert "http" not in page.replace("http-equiv", "")


def test_a_swap_by_an_equivalent_is_no_further_set():
    spring = _named("spring", (3,), Place("balancer", (3,)))
    sets = (
        Alternative((Place("balancer", (3,)),), -1.0, MOTION),
        Alternative((Place("offset", (2,)),), -2.0, MOTION),
    )
    how = {"fit": [], "held_out": [], "model": None}
    told = summary("ab", _verdict(spring, alternatives=sets), how)
    assert told["classes"] == [["spring on joint 3", "balancer on joint 3"]]
    assert told["twins"] == [
        "balancer on joint 3",
        "offset on joint 2 in place of spring on joint 3",
    ]
