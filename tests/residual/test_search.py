"""Score and search on linear problems whose answer is known, against dense algebra."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from residual.diagnosis.candidates import price_keys
from residual.diagnosis.detectable import DetectionModel
from residual.diagnosis.findings import estimate_uncertainties
from residual.diagnosis.rivals import find_rival_sets
from residual.diagnosis.score import label_blocks
from residual.diagnosis.search import CURVES, add_curves, refine_last_shape
from residual.diagnosis.select import _replace_constants, name_probability
from residual.effects import load_effects
from residual.effects.base import Effect, EffectTrait, ShapeRefinement
from residual.effects.base import build_joint_columns as joint_columns
from residual.evidence.fit import fit_jointly
from residual.evidence.thresholds import THRESHOLDS
from tests.residual.arms import arm
from tests.residual.linear import (
    BLOCK,
    DOF,
    GEAR,
    LINE,
    LOAD,
    NOMINAL,
    OTHER,
    PLANE,
    Problem,
    build,
    every_group,
)

# Laws of the evidence by blocks and of left-out blocks, against dense algebra.


# A column that the nominal model has too: a refit can imitate the effect exactly.
TWIN = Effect(
    "twin",
    "a nominal column",
    {"a": "1"},
    lambda s, joints, x: s.regressor[:, :, 10:11],
    scope="flange",
)
SETS = {"one joint": (PLANE, (0,)), "pair": (GEAR, (0, 1)), "all rows": (LOAD, (1,))}


def bent(rng, deviations, noise=1.0):
    """A nominal model whose one coefficient is wrong by many deviations."""
    drawn = Problem.draw(rng, rows=200, noise=noise)
    size = deviations / np.sqrt(drawn.prior.precision[10, 10])
    logs = [(replace(t, tau=t.tau + size * s.regressor[:, :, 10]), s) for t, s in drawn.logs]
    return Problem(logs, build(logs), drawn.prior)


def nats_of(problem, effect, joints):
    (group,) = problem.design.add([(effect, joints, ())])
    return problem.score.nats(problem.score.fit([group]), group)


@pytest.mark.parametrize("turn", [[[1e-4, 0.0], [0.0, 2e3]], [[1.0, -2.0], [0.5, 1.0]]])
def test_units_of_columns_and_their_order_do_not_matter(rng, turn):
    problem = Problem.draw(rng, [(PLANE, (0,), [0.3, 0.2])])
    turned = replace(PLANE, columns=lambda s, j, x: PLANE.columns(s, j, x) @ np.array(turn))
    one, other = (nats_of(problem, e, (0,)) for e in (PLANE, turned))
    assert one > 5
    assert other == pytest.approx(one, rel=1e-6)


def test_a_fit_does_not_depend_on_what_it_is_compared_with(rng):
    """Two joints ask for other parameters: neither wins by where the fit began."""
    drawn = Problem.draw(rng, rows=200, noise=0.1, slow=0.9, bend=0.0)
    ways = rng.normal(size=(DOF, NOMINAL)) / np.sqrt(np.diag(drawn.prior.precision))
    logs = [
        (replace(t, tau=t.tau + np.einsum("njp,jp->nj", s.regressor, ways)), s)
        for t, s in drawn.logs
    ]
    score = Problem(logs, build(logs), drawn.prior).score
    plain = score.fit(())
    few, all_rows = THRESHOLDS.min_rows, score.design.rows.max()
    for counted in ([few, all_rows], [all_rows, few]):
        other = score.fit((), replace(plain, counted=np.array(counted)))
        assert other.sse == pytest.approx(plain.sse, rel=0.05)


@pytest.mark.parametrize("order", [[3, 2, 1, 0], [1, 3, 0, 2]])
def test_the_order_of_logs_and_so_of_their_blocks_does_not_matter(rng, order):
    problem = Problem.draw(rng, [(LINE, (0,), [0.3])], masked=0.2, colour=0.5)
    logs = [problem.logs[i] for i in order]
    other = Problem(logs, build(logs), problem.prior)
    values = [nats_of(p, LINE, (0,)) for p in (problem, other)]
    assert values[0] == pytest.approx(values[1], rel=1e-6)


def test_blocks_that_disagree_bear_out_less_than_blocks_that_agree(rng):
    """The same torque on average, of another sign in every third block."""
    values = []
    for sizes in ([1.0, 1.0, 1.0], [3.0, 3.0, -3.0]):
        drawn = Problem.draw(np.random.default_rng(3), rows=360, noise=0.3)
        logs = []
        for own, state in drawn.logs:
            tau = own.tau.copy()
            size = np.resize(np.repeat(sizes, BLOCK), len(tau))
            tau[:, 0] += size * state.q[:, 0]
            logs.append((replace(own, tau=tau), state))
        values.append(nats_of(Problem(logs, build(logs), drawn.prior), LINE, (0,)))
    assert values[1] < values[0] / 2


@pytest.mark.parametrize("which", SETS)
def test_a_left_out_block_is_predicted_by_a_dense_fit_of_the_others(rng, which):
    effect, joints = SETS[which]
    problem = Problem.draw(rng, [(PLANE, (0,), [1.0, 1.0])], masked=0.2)
    members = problem.design.add([(effect, joints, ())])
    fitted = problem.score.fit(members)
    left = problem.score.left_out(fitted)
    even = np.exp(np.log(fitted.counted / problem.design.rows).mean())
    weight = even / fitted.variance
    np.testing.assert_allclose(left.weight, weight)
    x, y, joint = problem.stacked(members)
    block = np.concatenate(
        [
            (np.arange(len(t.tau)) // BLOCK + k * len(t.tau) // BLOCK)[t.moving[:, j]]
            for j in range(DOF)
            for k, (t, _) in enumerate(problem.logs)
        ]
    )
    for out in range(problem.design.folds):
        rest, own = block != out, block == out
        a = problem.precision(members)
        a = a + (x[rest].T * weight[joint[rest]]) @ x[rest]
        theta = np.linalg.solve(a, (x[rest].T * weight[joint[rest]]) @ y[rest])
        error = (y[own] - x[own] @ theta) ** 2
        expected = [error[joint[own] == j].sum() for j in range(DOF)]
        np.testing.assert_allclose(left.errors[out], expected, rtol=1e-8)


@pytest.mark.parametrize("deviations", [3.0, 30.0, 100.0, 300.0])
def test_of_two_fixed_points_of_noise_and_coefficients_the_likelier_is_taken(rng, deviations):
    """What the prior holds back is noise, or the prior gives way: both are stable."""
    problem = bent(rng, deviations, noise=0.05)
    design, prior, score = problem.design, problem.prior, problem.score
    fitted = score.fit(())
    floor = (THRESHOLDS.noise_floor * design.rms) ** 2
    starts = [fit_jointly(design, prior, (), fitted.counted, start, 40) for start in (None, floor)]
    assert fitted.score > max(f.score for f in starts) - 0.1


def test_a_name_is_likelier_the_more_speaks_for_it():
    values = [name_probability(nats) for nats in np.geomspace(0.1, 1000, 60)]
    assert all(less < more for less, more in pairwise(values))
    assert name_probability(-5.0) < 1e-3
    assert name_probability(THRESHOLDS.even_nats) == pytest.approx(0.5)
    sure = name_probability(THRESHOLDS.named_nats)
    assert sure == pytest.approx(THRESHOLDS.sure_probability)


@pytest.mark.parametrize("logs", [1, 3, 40])
def test_no_block_has_parts_of_two_logs_and_rows_ascend(rng, logs):
    problem = Problem.draw(rng, rows=1000, logs=logs)
    labels = label_blocks([t for t, _ in problem.logs])
    for one, other in pairwise(labels):
        assert other[0] == one[-1] + 1
    every = np.concatenate(labels)
    assert set(np.diff(every)) <= {0, 1}
    blocks = every[-1] + 1
    assert THRESHOLDS.min_blocks <= blocks <= THRESHOLDS.max_blocks


# The search on linear problems whose answer is known.


WAVE = Effect(
    "wave",
    "periodic in place",
    {"cos": "1", "sin": "1", "order": "1"},
    joint_columns(lambda s, j, x: [np.cos(x[0] * s.q[:, j]), np.sin(x[0] * s.q[:, j])]),
    values=lambda theta, shape, robot: np.array([*theta, shape[0]]),
    from_values=lambda values: (values[:2], tuple(values[2:])),
    refine=ShapeRefinement("shift", 0.8),
)


def keys(members):
    return sorted((g.effect.name, g.joints) for g in members)


def with_curves(problem):
    curves = add_curves(problem.design, [t for t, _ in problem.logs], centred=True)
    return problem.search(every_group(problem.design), curves)


def with_torque(problem, torque):
    """The same with a torque of the state on joint 1, but its mean."""
    mean = np.mean([torque(state) for _, state in problem.logs])
    logs = []
    for own, state in problem.logs:
        tau = own.tau.copy()
        tau[:, 0] += torque(state) - mean
        logs.append((replace(own, tau=tau), state))
    return Problem(logs, build(logs), problem.prior)


def test_where_nothing_is_missing_nothing_is_found():
    """Ten draws, also with autocorrelated noise and motion."""
    for seed in range(10):
        slow = 0.8 * (seed % 2)
        rng = np.random.default_rng(seed)
        problem = Problem.draw(rng, rows=100, colour=slow, slow=slow)
        assert with_curves(problem).run().fit.members == ()


TRUTHS = {
    "one joint": [(LINE, (0,), [3.0])],
    "two columns": [(PLANE, (1,), [2.0, -2.0])],
    "all rows": [(LOAD, (1,), [1.5, -1.0, 1.0])],
    "two effects": [(LINE, (1,), [2.0]), (PLANE, (0,), [2.0, 2.0])],
    "two joints": [(OTHER, (0,), [2.0]), (OTHER, (1,), [-2.0])],
}


def test_of_names_that_blocks_cannot_tell_apart_the_plainest_is_shown(rng):
    problem = Problem.draw(rng, [(LINE, (0,), [3.0]), (OTHER, (1,), [3.0])], rows=200)
    odd = replace(LINE, name="odd", far_fetched=0.5)
    places = [(odd, (0,), ()), (LINE, (0,), ()), (replace(OTHER, far_fetched=0.5), (1,), ())]
    far, line, other = problem.design.add(places)
    search = problem.search([far, line, other])
    found = search.settle((far, other))
    assert search.name_plainly(found, far).named == (other, line)
    assert search.name_plainly(found, other) is found


def test_what_a_constant_that_fell_has_hidden_is_found_in_its_place(rng):
    problem = Problem.draw(rng, [(LINE, (0,), [3.0]), (LINE, (1,), [3.0])], rows=200)
    level = Effect(
        "level",
        "a constant",
        {"a": "1"},
        joint_columns(lambda s, j, x: [np.ones(len(s.q))]),
        traits=EffectTrait.CONSTANT,
    )
    places = [(LINE, (0,), ()), (LINE, (1,), ()), (level, (0,), ())]
    line, other, constant = problem.design.add(places)
    look = problem.search([line, other, constant])
    found, former = _replace_constants(look, look.settle(()), [constant])
    # Nothing is looked for on a joint that lost no constant.
    assert found.named == (line,)
    assert former == {line: level}


@pytest.mark.parametrize("which", TRUTHS)
def test_what_is_there_is_found_and_nothing_else(rng, which):
    truth = TRUTHS[which]
    found = with_curves(Problem.draw(rng, truth, rows=200, masked=0.2)).run()
    assert keys(found.fit.members) == sorted((e.name, js) for e, js, _ in truth)
    for effect, joints, theta in truth:
        (own,) = (g for g in found.named if (g.effect, g.joints) == (effect, joints))
        np.testing.assert_allclose(found.fit.of(own), theta, atol=0.3)


FREE = {
    "q": lambda s: 4 * np.abs(s.q[:, 0]) ** 1.5,
    "qd": lambda s: 4 * np.maximum(s.qd[:, 0] - 0.5, 0.0),
}


@pytest.mark.parametrize("signal", FREE)
def test_a_joint_that_follows_a_curve_of_no_effect_has_no_name(rng, signal):
    drawn = Problem.draw(rng, rows=300, slow=0.8, noise=0.3)
    found = with_curves(with_torque(drawn, FREE[signal])).run()
    assert found.named == ()
    assert [(g.effect, g.joints) for g in found.curves] == [(CURVES[signal], (0,))]


@pytest.mark.parametrize("effect", [LINE, OTHER])
def test_a_name_stands_although_a_curve_could_draw_it(rng, effect):
    drawn = Problem.draw(rng, [(effect, (0,), [1.0])], rows=300, slow=0.8, noise=0.3)
    found = with_curves(drawn).run()
    assert keys(found.fit.members) == [(effect.name, (0,))]


def test_a_wrong_value_that_a_refit_imitates_is_found(rng):
    problem = bent(rng, 30.0)
    (twin,) = problem.design.add([(TWIN, (1,), ())])
    found = problem.search([twin, *every_group(problem.design)]).run()
    assert keys(found.named) == [("twin", (1,))]
    size = 30.0 / np.sqrt(problem.prior.precision[10, 10])
    np.testing.assert_allclose(found.fit.of(found.named[0]), size, rtol=0.1)


def test_what_is_there_in_one_log_of_four_only_is_not_named(rng):
    problem = Problem.draw(rng, rows=200)
    (own, state), *others = problem.logs
    tau = own.tau.copy()
    tau[:, 0] += 3 * state.q[:, 0]
    logs = [(replace(own, tau=tau), state), *others]
    problem = Problem(logs, build(logs), problem.prior)
    assert problem.search(problem.design.add([(LINE, (0,), ())])).run().named == ()


def test_what_hardly_lowers_the_error_is_not_named_however_sure(rng):
    """A hundredth of torque and of what is left: certain, and not worth a name."""
    problem = Problem.draw(rng, [(LINE, (0,), [0.02])], rows=8000, noise=0.3)
    (group,) = problem.design.add([(LINE, (0,), ())])
    search = problem.search([group])
    assert search.look(search.score.fit(()))[0].nats > THRESHOLDS.named_nats
    assert search.run().named == ()


def test_a_set_that_was_given_loses_what_does_not_carry_its_price(rng):
    problem = Problem.draw(rng, [(LINE, (0,), [3.0])], rows=200)
    groups = problem.design.add([(LINE, (0,), ()), (PLANE, (1,), ())])
    assert keys(problem.search(groups).settle(tuple(groups)).named) == [("line", (0,))]


@pytest.mark.parametrize("which", [0, 1])
def test_a_search_that_begins_with_another_search_s_names_ends_with_its_own(rng, which):
    """A false name in the start, and a true one missing from it."""
    problem = Problem.draw(rng, [(LINE, (0,), [3.0]), (PLANE, (1,), [2.0, -2.0])], rows=200)
    search = problem.search(every_group(problem.design))
    start = [g for g in search.candidates.groups if g.key in {("other", (1,)), ("line", (0,))}]
    warm = search.run(search.select_allowed(start[which : which + 1]))
    assert keys(warm.named) == keys(search.run().named) == [("line", (0,)), ("plane", (1,))]
    without = search.candidates.without(["line"])
    assert "line" not in {
        n for n, _ in keys(replace(search, candidates=without).select_allowed(start))
    }


def test_a_link_costs_a_choice_among_the_links_beside_that_among_the_keys():
    effects = load_effects()
    groups = [
        SimpleNamespace(key=(name, (j,)), effect=effects[name])
        for name in ("viscous", "link_inertia")
        for j in range(3)
    ]
    price = price_keys(groups, 3)
    assert price["viscous", (0,)] == pytest.approx(np.log(6))
    assert price["link_inertia", (0,)] == pytest.approx(np.log(6) + np.log(3))


def test_a_search_whose_member_drops_what_brings_it_back_ends(rng, monkeypatch):
    """On a measured arm one name and another took turns for ever."""
    problem = Problem.draw(rng, [(LINE, (0,), [3.0])], rows=200)
    first, second = problem.design.add([(LINE, (0,), ()), (PLANE, (1,), ())])
    search = problem.search([first, second])
    joins = []

    def join(self, base, best):
        now = first if first not in base.members else second
        joins.append(now)
        fitted = self.score.fit((now,))
        return fitted, self.score.left_out(fitted)

    monkeypatch.setattr(type(search), "_join", join)
    monkeypatch.setattr(type(search), "_choose", lambda self, trials, left: first)
    search.run()
    assert joins == [first, second, first]


# As on an arm: columns slower than what is left, of whose rows a quarter counts.
SLOW = {"rows": 300, "colour": 0.6, "slow": 0.9}


@cache
def smallest(seed):
    null = Problem.draw(np.random.default_rng(seed), **SLOW)
    (group,) = null.design.add([(LINE, (0,), ())])
    search = null.search([group])
    bench = DetectionModel.of(search, search.score.fit(()))
    return bench.smallest(group, np.ones(1))


def detection_rate(share, draws=24):
    hits = []
    for seed in range(draws):
        truth = [(LINE, (0,), [share * smallest(seed)])]
        there = Problem.draw(np.random.default_rng(seed), truth, **SLOW)
        groups = there.design.add([(LINE, (0,), ())])
        search = there.search(groups)
        named = search.run().named
        nats = [search.score.nats(search.score.fit(named), g) for g in named]
        hits.append(max(nats, default=0.0) >= THRESHOLDS.named_nats)
    return np.mean(hits)


@pytest.mark.parametrize(
    ("share", "least_rate", "most_rate"), [(0.6, 0, 0.2), (1, 0.25, 0.75), (1.6, 0.8, 1)]
)
def test_the_odds_turn_at_the_smallest_detectable_size(share, least_rate, most_rate):
    assert least_rate <= detection_rate(share) <= most_rate


def _wave(state):
    angle = 7.37 * state.q[:, 0]
    return 2 * np.cos(angle) - np.sin(angle)


def test_error_bars_of_a_searched_shape_hold_the_truth():
    """cos, sin and order of a wave: two sigma in 85 to 100 % of 30 draws."""
    inside = []
    for seed in range(30):
        drawn = Problem.draw(np.random.default_rng(seed), logs=2)
        problem = with_torque(drawn, _wave)
        score, group = problem.score, problem.design.add([(WAVE, (0,), (7.2,))])
        (member,) = refine_last_shape(score, group, score.fit(group))
        fitted = score.fit([member])
        exact = {member: (fitted.of(member), np.zeros((2, 2)))}
        (sd,) = estimate_uncertainties(seen(score), fitted, exact).values()
        values = [*fitted.of(member), member.shape[0]]
        inside += list(np.abs(np.array(values) - [2.0, -1.0, 7.37]) < 2 * sd.std)
    assert 0.85 <= np.mean(inside) <= 1.0


def seen(score):
    """What `estimate_uncertainties` reads of an outcome."""
    return SimpleNamespace(
        score=score,
        design=score.design,
        prior=score.prior,
        selection=SimpleNamespace(wide=score.prior),
        logs=SimpleNamespace(robot=arm(), span=None),
    )


# How sure a parameter is: by noise, by logs that disagree, by other textbook forms.


DRAWS = 20
READS = Effect(
    "reads", "reads the model", {"a": "1"}, joint_columns(lambda s, j, x: [s.tau_model[:, j]])
)
READS = replace(READS, traits=EffectTrait.USES_MODEL | EffectTrait.GROUPABLE)


def deviation(problem, shape):
    """Coefficient and deviation of the first parameter of one effect on joint 1."""
    effect, form = shape
    (group,) = problem.design.add([(effect, (0,), form)])
    fitted = problem.score.fit([group])
    theta = fitted.of(group)
    exact = {group: (theta, np.zeros((len(theta), len(theta))))}
    (sd,) = estimate_uncertainties(seen(problem.score), fitted, exact).values()
    return theta[0], sd.std, np.sqrt(np.diag(fitted.covariance())[fitted.slots(group)])


def disagreeing(seed, scatter):
    """An effect whose size differs from log to log, about 2."""
    rng = np.random.default_rng(seed)
    problem = Problem.draw(rng, noise=0.1, logs=6)
    sizes = 2.0 + scatter * rng.normal(size=6)
    logs = []
    for (own, state), size in zip(problem.logs, sizes, strict=True):
        tau = own.tau.copy()
        tau[:, 0] += size * state.q[:, 0]
        logs.append((replace(own, tau=tau), state))
    return Problem(logs, build(logs), problem.prior)


def test_logs_that_disagree_make_a_parameter_less_sure():
    """Two deviations hold the common size in nine of ten draws; noise's own do not."""
    inside, by_noise = [], []
    for seed in range(DRAWS):
        value, sd, own = deviation(disagreeing(seed, 0.3), (LINE, ()))
        inside.append(abs(value - 2.0) < 2 * sd[0])
        by_noise.append(abs(value - 2.0) < 2 * own[0])
    assert np.mean(inside) >= 0.85
    assert np.mean(by_noise) < 0.6


# Sets of effects that are as good as the one named.


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
