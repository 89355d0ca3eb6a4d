"""What a diagnosis leaves open, and what motions say to that."""

from dataclasses import replace

import numpy as np

from benchmarks.loop_parts.next import logged_products
from residual.planning.next_experiment import (
    MotionInformation,
    find_inseparable_pairs,
    mark_inseparable_alternatives,
    predict_best_motion,
)
from residual.verdict.result import Alternative, Place
from tests.residual.planning.questions import SECONDS, logs, robot_and_question

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
    _, question = robot_and_question("spring", 2)
    assert find_inseparable_pairs(question) == set()
    assert predict_best_motion(question) is not None
    tiny = shrunk_to(question, 0.01)
    assert find_inseparable_pairs(tiny) == {(0, 0, 1), (0, 1, 0)}
    assert predict_best_motion(tiny) is None


def test_a_set_that_no_motion_tells_from_the_named_one_is_marked():
    _, question = robot_and_question("spring", 2)
    named = [Place("spring", (3,)), Place("offset", (1,))]
    sets = ((Place("offset", (1,)), Place("balancer", (3,))), (Place("offset", (1,)),))
    others = [Alternative(one, -1.0, "motion") for one in sets]

    def by(robot_and_question):
        return [
            a.separated_by for a in mark_inseparable_alternatives(robot_and_question, named, others)
        ]

    assert by(question) == ["motion", "motion"]
    assert by(shrunk_to(question, 0.01)) == ["nothing", "motion"]


def test_a_planned_motion_is_seen_as_its_log_will_be():
    """Nothing is filtered where a motion is planned; its log is, and has noise."""
    _, question = robot_and_question("spring", 2)
    _, (log, _) = logs("spring", 2)
    ((seen, _),) = logged_products(question, log, [SECONDS])
    q = np.column_stack([np.convolve(c, np.ones(9) / 9, "same") for c in log.q.T])
    qd = np.gradient(q, 1 / 250, axis=0)
    every = [x[10:-10:5] for x in (q, qd, np.gradient(qd, 1 / 250, axis=0))]
    planned = MotionInformation.of(question, every, RATE).gram(SECONDS)
    own = question.contests[0].rivals[0].effect_columns
    ratio = np.diag(planned)[own] / np.diag(seen)[own]
    # Rows within 0.1 s of a turn are a matter of a sample more or less.
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
