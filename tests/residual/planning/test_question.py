"""What a diagnosis leaves open, and what motions say to that."""

from dataclasses import replace

import numpy as np

from benchmarks.loop_parts.next import logged_products
from residual.diagnosis import open_question as gather
from residual.diagnosis.neighbours import Rival
from residual.diagnosis.open_question import open_question
from residual.planning.promise import Course, promised, settled_by, structural_twins
from residual.planning.question import NOTHING, TOGETHER
from residual.verdict.result import Alternative, Place
from tests.residual.planning.asked import SECONDS, asked, logs, seen

RATE = 50.0  # Hz


def shrunk_to(question, size):
    (contest,) = question.contests
    rivals = []
    for one in contest.rivals:
        mean = one.mean.copy()
        mean[np.isin(one.columns, one.effect_columns)] *= size
        rivals.append(replace(one, mean=mean))
    return replace(question, contests=(replace(contest, rivals=tuple(rivals)),))


def test_a_spring_of_some_size_is_no_twin_of_a_balancer_and_a_tiny_one_is():
    _, question = asked("spring", 2)
    assert structural_twins(question) == set()
    assert promised(question) is not None
    tiny = shrunk_to(question, 0.01)
    assert structural_twins(tiny) == {(0, 0, 1), (0, 1, 0)}
    assert promised(tiny) is None


def test_a_set_that_no_motion_tells_from_the_named_one_is_marked():
    _, question = asked("spring", 2)
    named = [Place("spring", (3,)), Place("offset", (1,))]
    sets = ((Place("offset", (1,)), Place("balancer", (3,))), (Place("offset", (1,)),))
    others = [Alternative(one, -1.0, "motion") for one in sets]

    def by(asked):
        return [a.separated_by for a in settled_by(asked, named, others)]

    assert by(question) == ["motion", "motion"]
    assert by(shrunk_to(question, 0.01)) == ["nothing", "motion"]


def test_a_planned_motion_is_seen_as_its_log_will_be():
    """Nothing is filtered where a motion is planned; its log is, and has noise."""
    _, question = asked("spring", 2)
    _, (log, _) = logs("spring", 2)
    ((seen, _),) = logged_products(question, log, [SECONDS])
    q = np.column_stack([np.convolve(c, np.ones(9) / 9, "same") for c in log.q.T])
    qd = np.gradient(q, 1 / 250, axis=0)
    every = [x[10:-10:5] for x in (q, qd, np.gradient(qd, 1 / 250, axis=0))]
    planned = Course.of(question, every, RATE).gram(SECONDS)
    own = question.contests[0].rivals[0].effect_columns
    ratio = np.diag(planned)[own] / np.diag(seen)[own]
    # Rows within 0.1 s of a turn are a matter of a sample more or less.
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)


def test_a_candidate_without_evidence_is_no_rival_of_nothing(monkeypatch):
    """A joint is doubted, and nothing speaks for any candidate there."""
    outcome, *_ = seen("spring", 2)
    doubted = replace(outcome, adequacy=replace(outcome.adequacy, doubted=(2,)))
    (contest,) = open_question(doubted, outcome.plain, []).contests
    assert contest.rivals[-1].place == NOTHING
    assert {"spring", "balancer"} & {r.place.name for r in contest.rivals}
    assert len(contest.rivals) <= 1 + gather.CANDIDATES
    monkeypatch.setattr(gather, "screen", lambda *words: np.zeros(len(words[2])))
    assert open_question(doubted, outcome.plain, []).contests == ()


def test_sets_that_are_as_good_are_rivals_of_what_they_would_replace(monkeypatch):
    outcome, fitted, named = seen("spring", 2)
    gone, *rest = fitted.members
    others = [
        g
        for g in outcome.task.candidates.groups
        if g.effect.name in ("offset", "coulomb_asymmetry") and g.joints == (5,)
    ][:2]
    sets = [Rival((*rest, *others), -1.0), Rival(tuple(rest), -2.0)]
    monkeypatch.setattr("residual.diagnosis.open_question.near_sets", lambda *_: sets)
    contest = open_question(outcome, fitted, named).contests[-1]
    names = TOGETHER.join(g.effect.name for g in others)
    places = [r.place for r in contest.rivals]
    assert [p.name for p in places] == ["spring", "balancer", names, NOTHING.name]
    assert gone.effect.name == "spring"
    assert places[2].joints == (6,)
    assert [len(r.effect_columns) for r in contest.rivals] == [
        len(gone.ids),
        2,
        sum(len(g.ids) for g in others),
        0,
    ]
    # Two names cost more than the one that is really there, and nothing explains less.
    assert contest.rivals[0].nats > contest.rivals[2].nats


def test_a_rival_whose_precision_cannot_be_inverted_makes_nothing_be_promised():
    """As of logs that no arm of that description gives, and that are trusted all the
    same."""
    outcome, fitted, named = seen("spring", 2)
    question = open_question(outcome, fitted, named)
    basis = gather.Basis.of(outcome, fitted, fitted.members)
    (contest,) = question.contests
    first, *others = contest.rivals
    flat = np.ones_like(first.precision)
    broken = replace(contest, rivals=(replace(first, precision=flat), *others))
    left = gather.question_of(basis, [broken])
    assert left.contests == ()
    assert promised(left) is None
    assert promised(question) is not None
