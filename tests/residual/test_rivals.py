"""Sets of effects that are as good as the one named."""

from residual.diagnosis.rivals import find_rival_sets
from tests.residual.linear import GEAR, LINE, OTHER, PLANE, Problem


def every(problem, effects):
    return [
        group
        for effect in effects
        for joints in effect.candidates(2)
        for group in problem.design.add([(effect, joints, ())])
    ]


def places(members):
    return sorted((g.effect.name, g.joints) for g in members)


def test_two_names_give_way_to_the_one_that_does_what_both_do(rng):
    """A plane is a line of speed and one of acceleration: one name says both."""
    problem = Problem.draw(rng, [(PLANE, (0,), [3.0, 3.0])], rows=300, noise=0.3)
    groups = every(problem, (LINE, OTHER, PLANE, GEAR))
    at = {(g.effect.name, g.joints): g for g in groups}
    wrong = at["other", (0,)], at["line", (0,)], at["plane", (0,)]
    assert places(problem.search(groups).run(wrong).named) == [("plane", (0,))]


def test_sets_as_good_are_listed_and_far_ones_are_not(rng):
    truth = [(LINE, (0,), [3.0]), (OTHER, (1,), [3.0])]
    problem = Problem.draw(rng, truth, rows=300)
    search = problem.search(every(problem, (LINE, OTHER, PLANE)))
    wanted = [("line", (0,)), ("other", (1,))]
    groups = search.candidates.groups
    named = [g for g in groups if (g.effect.name, g.joints) in wanted]
    others = find_rival_sets(search, search.score.fit(named))
    assert all(r.nats > -6 for r in others)
    sets = [places(r.members) for r in others]
    # The plane holds the speed as well; a line of joint 1 holds nothing of joint 2.
    assert [("line", (0,)), ("plane", (1,))] in sets
    assert [("line", (0,))] not in sets
