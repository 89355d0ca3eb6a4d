"""Search and gate on linear problems whose answer is known."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from residual.diagnosis.gate import cross_validation_errors, judge_members_by_gate
from residual.diagnosis.gate import drop_members_failing_gate as drop_failing

from residual.diagnosis.detectable import find_detectable_sizes
from residual.diagnosis.findings import estimate_uncertainties, merge_into_findings
from residual.diagnosis.search import lowers_error, rank_additions, refine_last_shape
from residual.diagnosis.search import search_effect_set as effect_set
from residual.diagnosis.select import find_member_alternatives as member_alternatives
from residual.diagnosis.select import select_set_and_prior as select_best
from residual.diagnosis.select import swap_for_simpler_names
from residual.effects.base import Effect, EffectTrait, ShapeRefinement
from residual.effects.base import build_joint_columns as joint_columns
from residual.evidence.thresholds import EvidenceThresholds as Thresholds
from tests.residual.arms import arm
from tests.residual.linear import (
    DOF,
    LINE,
    LOAD,
    OTHER,
    PLANE,
    Problem,
    build,
    every_group,
)

# A column that the nominal model has too: a refit can imitate the effect exactly.
TWIN = Effect(
    "twin",
    "a nominal column",
    {"a": "1"},
    lambda s, joints, x: s.regressor[:, :, 10:11],
    scope="flange",
)
WAVE = Effect(
    "wave",
    "periodic in place",
    {"cos": "1", "sin": "1", "order": "1"},
    joint_columns(lambda s, j, x: [np.cos(x[0] * s.q[:, j]), np.sin(x[0] * s.q[:, j])]),
    values=lambda theta, shape, robot: np.array([*theta, shape[0]]),
    from_values=lambda values: (values[:2], tuple(values[2:])),
    refine=ShapeRefinement("shift", 0.8),
)


def judged_by(task):
    logs = SimpleNamespace(robot=arm(), span=None)
    return SimpleNamespace(task=task, logs=logs, wide=task.prior)


def keys(fitted):
    return sorted((g.effect.name, g.joints) for g in fitted.members)


def searched(problem, **rules):
    task = problem.task(every_group(problem.design), **rules)
    return task, effect_set(task)


def test_where_nothing_is_missing_nothing_is_found():
    """20 draws, also with autocorrelated noise: no name, and no close call."""
    loudest = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        problem = Problem.draw(rng, rows=100, colour=0.8 * (seed % 2))
        task, fitted = searched(problem)
        assert fitted.members == ()
        lenient = Thresholds(min_nats=-99, min_fall_share=0)
        value = rank_additions(replace(task, rules=lenient), fitted)
        loudest += [v for v, _, _ in value[:1]]
    assert max(loudest) < Thresholds().min_nats / 2


TRUTHS = {
    "one joint": [(LINE, (0,), [3.0])],
    "two columns": [(PLANE, (1,), [2.0, -2.0])],
    "all rows": [(LOAD, (1,), [1.5, -1.0, 1.0])],
    "two effects": [(LINE, (1,), [2.0]), (PLANE, (0,), [2.0, 2.0])],
    "two joints": [(OTHER, (0,), [2.0]), (OTHER, (1,), [-2.0])],
}


@pytest.mark.parametrize("which", TRUTHS)
def test_what_is_there_is_found_and_nothing_else(rng, which):
    truth = TRUTHS[which]
    _, fitted = searched(Problem.draw(rng, truth, rows=200, masked=0.2))
    assert keys(fitted) == sorted((e.name, js) for e, js, _ in truth)
    for effect, joints, theta in truth:
        (own,) = (g for g in fitted.members if (g.effect, g.joints) == (effect, joints))
        np.testing.assert_allclose(fitted.of(own), theta, atol=0.3)


def _wave(state, order):
    torque = np.zeros_like(state.q)
    torque[:, 0] = 2 * np.cos(order * state.q[:, 0]) - np.sin(order * state.q[:, 0])
    return torque


@pytest.fixture
def imitated(rng):
    """A missing effect that the nominal can take over, if it bends by 30 sigma."""
    task = Problem.draw(rng, rows=200, noise=1.0)
    size = 30 / np.sqrt(task.prior.precision[10, 10])
    logs = [
        (replace(t, tau=t.tau + size * s.regressor[:, :, 10]), s) for t, s in task.logs
    ]
    task = Problem(logs, build(logs), task.prior)
    groups = [*task.design.add([(TWIN, (1,), ())]), *every_group(task.design)]
    return task, task.task(groups), size


def test_an_effect_that_a_refit_imitates_is_named_by_plausibility(imitated):
    _, task, size = imitated
    fitted = effect_set(task)
    assert keys(fitted) == [("twin", (1,))]
    np.testing.assert_allclose(fitted.of(fitted.members[0]), size, rtol=0.1)
    (tested,) = judge_members_by_gate(task, fitted)
    assert tested.by == "plausibility"
    assert tested.nats > task.rules.min_plausible_nats


def test_a_left_out_log_is_predicted_by_a_fit_of_the_others(rng):
    problem = Problem.draw(rng, [(PLANE, (0,), [1.0, 1.0])], masked=0.2)
    members = problem.design.add([(PLANE, (0,), ())])
    task = problem.task(members)
    fitted = task.settle(task.fit(members, task.start()))
    errors = cross_validation_errors(task, fitted)
    weight = fitted.counted / problem.design.rows / fitted.variance
    for k in range(len(problem.logs)):
        others = [i for i in range(len(problem.logs)) if i != k]
        x, y, joint = problem.stacked(members, others)
        a = problem.precision(members) + (x.T * weight[joint]) @ x
        theta = np.linalg.solve(a, (x.T * weight[joint]) @ y)
        x, y, joint = problem.stacked(members, [k])
        left = (y - x @ theta) ** 2
        expected = [left[joint == j].sum() for j in range(DOF)]
        np.testing.assert_allclose(errors[k], expected, rtol=1e-6)


def test_the_gate_stops_what_is_there_in_one_log_of_four_only(rng):
    problem = Problem.draw(rng, rows=200)
    logs = list(problem.logs)
    first, state = logs[0]
    tau = first.tau.copy()
    tau[:, 0] += 3 * state.q[:, 0]
    logs[0] = (replace(first, tau=tau), state)
    problem = Problem(logs, build(logs), problem.prior)
    (group,) = problem.design.add([(LINE, (0,), ())])
    task = problem.task([group])
    fitted = task.settle(task.fit([group], task.start()))
    assert judge_members_by_gate(task, fitted)[0].by is None
    after, tested = drop_failing(task, fitted)
    assert (after.members, tested) == ((), [])


def near_copy(size):
    return replace(
        LINE,
        name="near",
        traits=EffectTrait.NONE,
        columns=lambda s, j, x: LINE.columns(s, j, x) + size * OTHER.columns(s, j, x),
    )


@pytest.mark.parametrize(("size", "told_apart"), [(0.01, False), (1.0, True)])
def test_what_cannot_be_told_apart_is_listed_with_the_name(rng, size, told_apart):
    problem = Problem.draw(rng, [(LINE, (0,), [3.0])], rows=200)
    near = problem.design.add([(near_copy(size), (0,), ())])
    task = problem.task([*near, *every_group(problem.design)])
    fitted = task.settle(task.fit([task.candidates.groups[1]], task.start()))
    assert keys(fitted) == [("line", (0,))]
    others, probability = member_alternatives(task, fitted, fitted.members[0])
    assert [g.effect.name for g in others] == ([] if told_apart else ["near"])
    assert probability > 0.99


def test_of_two_names_that_explain_the_same_the_simpler_is_taken(rng):
    """PLANE has LINE's column and a second one that explains nothing."""
    wider = replace(
        PLANE,
        columns=lambda s, j, x: np.concatenate(
            [LINE.columns(s, j, x), OTHER.columns(s, j, x)], axis=2
        ),
    )
    problem = Problem.draw(rng, [(LINE, (0,), [3.0])], rows=200)
    both = problem.design.add([(LINE, (0,), ()), (wider, (0,), ())])
    task = problem.task(both)
    fitted = task.settle(task.fit([both[1]], task.start()))
    assert keys(swap_for_simpler_names(task, fitted)) == [("line", (0,))]


def prior_space(design, priors):
    """A space of a few priors by scale, with no given values."""
    return SimpleNamespace(
        design=design,
        scales=tuple(priors),
        even=({},),
        free=False,
        at=lambda scale, widths: priors[scale],
        list_barred_effects=lambda prior: set(),
    )


@pytest.mark.parametrize("bend", [0.1, 1.0, 10.0])
def test_the_scale_of_the_prior_is_the_one_that_the_nominal_is_off_by(rng, bend):
    problem = Problem.draw(rng, rows=200, noise=0.05, bend=bend)
    task = problem.task(every_group(problem.design))
    choices = {}
    for scale in (0.1, 1.0, 10.0):
        precision = problem.prior.precision / scale**2
        log_det = float(np.linalg.slogdet(precision)[1])
        choices[scale] = replace(
            problem.prior, precision=precision, log_det=log_det, scale=scale
        )
    space = prior_space(problem.design, choices)
    assert select_best(space, task.candidates, Thresholds()).task.prior.scale == bend


def test_the_scale_is_chosen_so_that_it_does_not_swallow_the_effect(imitated):
    """A wide prior explains the twin as well; the narrow one with a name is better."""
    problem, task, _ = imitated
    wide = replace(
        problem.prior,
        precision=problem.prior.precision / 30**2,
        log_det=problem.prior.log_det - 20 * np.log(30**2),
        scale=0.9,
    )
    space = prior_space(problem.design, {0.9: wide, 0.03: problem.prior})
    chosen = select_best(space, task.candidates, Thresholds())
    assert chosen.task.prior.scale == 0.03
    assert keys(chosen.fit) == [("twin", (1,))]


# As on an arm: columns slower than what is left, of whose rows a quarter counts.
SLOW = {"rows": 300, "colour": 0.6, "slow": 0.9}


@cache
def smallest(seed):
    null = Problem.draw(np.random.default_rng(seed), **SLOW)
    group = null.design.add([(LINE, (0,), ())])
    task = null.task(group, min_fall=0.0, min_fall_share=0.0)
    (entry,) = find_detectable_sizes(task, task.start())
    assert (entry.name, entry.joints) == ("line", (1,))
    return entry.value


def detection_rate(share, draws=24):
    hits = []
    for seed in range(draws):
        truth = [(LINE, (0,), [share * smallest(seed)])]
        there = Problem.draw(np.random.default_rng(seed), truth, **SLOW)
        group = there.design.add([(LINE, (0,), ())])
        hits.append(
            bool(effect_set(there.task(group, min_fall=0, min_fall_share=0)).members)
        )
    return np.mean(hits)


@pytest.mark.parametrize(
    ("share", "least_rate", "most_rate"),
    [(0.6, 0, 0.2), (1, 0.15, 0.65), (1.6, 0.8, 1)],
)
def test_the_odds_turn_at_the_smallest_detectable_size(share, least_rate, most_rate):
    assert least_rate <= detection_rate(share) <= most_rate


def test_error_bars_of_a_searched_shape_hold_the_truth():
    """cos, sin and order of a wave: two sigma in 85 to 100 % of 30 draws."""
    inside = []
    for seed in range(30):
        problem = Problem.draw(np.random.default_rng(seed), logs=2)
        logs = [(replace(t, tau=t.tau + _wave(s, 7.37)), s) for t, s in problem.logs]
        problem = Problem(logs, build(logs), problem.prior)
        group = problem.design.add([(WAVE, (0,), (7.2,))])
        task = problem.task(group)
        members = refine_last_shape(task, group, task.fit(group, task.start()))
        fitted = task.settle(task.fit(members, task.start()))
        diagnosis = judged_by(task)
        exact = {members[0]: (fitted.of(members[0]), np.zeros((2, 2)))}
        (sd,) = estimate_uncertainties(diagnosis, fitted, exact).values()
        values = [*fitted.of(members[0]), members[0].shape[0]]
        inside += list(np.abs(np.array(values) - [2.0, -1.0, 7.37]) < 2 * sd.std)
    assert 0.85 <= np.mean(inside) <= 1.0


def test_findings_of_one_name_are_merged_and_the_largest_comes_first(rng):
    truth = [(LINE, (0,), [2.0]), (LINE, (1,), [2.0]), (PLANE, (0,), [4.0, 4.0])]
    task, fitted = searched(Problem.draw(rng, truth, rows=200))
    diagnosis = judged_by(task)
    first, second = merge_into_findings(
        diagnosis, fitted, judge_members_by_gate(task, fitted)
    )
    assert (first.effect.name, first.joints) == ("plane", (1,))
    assert (second.effect.name, second.joints) == ("line", (1, 2))
    values, sds, unit, _ = second.parameters["a"]
    assert (values.shape, sds.shape, unit) == ((2,), (2,), "1")
    np.testing.assert_allclose(values, 2.0, atol=5 * sds.max())
    assert second.nats == pytest.approx(sum(t.nats for t in second.tested))


@pytest.mark.parametrize(("yields", "first"), [(1.0, "plane"), (0.2, "line")])
def test_what_rides_on_another_of_its_size_is_named_before_it(rng, yields, first):
    truth = [(LINE, (0,), [4.0]), (PLANE, (0,), [3.0 * yields, 0.5])]
    task, fitted = searched(Problem.draw(rng, truth, rows=200))
    diagnosis = judged_by(task)
    riding = replace(PLANE, rides_on=LINE.name)
    tested = [
        replace(t, group=replace(t.group, effect=riding))
        if t.group.effect is PLANE
        else t
        for t in judge_members_by_gate(task, fitted)
    ]
    groups = {t.group.key: t.group for t in tested}
    fitted = replace(fitted, members=tuple(groups[g.key] for g in fitted.members))
    names = [f.effect.name for f in merge_into_findings(diagnosis, fitted, tested)]
    assert sorted(names) == ["line", "plane"]
    assert names[0] == first


def test_what_hardly_lowers_the_error_is_not_named_however_sure(rng):
    """3 % of torque rms, 1 % of what was left: certain, and not worth a name."""
    problem = Problem.draw(rng, [(LINE, (0,), [0.12])], rows=4000, logs=4)
    task, fitted = searched(problem)
    assert fitted.members == ()
    (group,) = (g for g in task.candidates.groups if g.key == ("line", (0,), ()))
    big = task.settle(task.fit([group], fitted))
    assert task.net_gain(big, fitted, group) > 20
    assert not lowers_error(task, big, fitted)
