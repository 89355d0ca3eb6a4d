"""The paper's chapter on runs: rows, schemes, table and what it must not hide."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from flows.report.words.calibration import sentences
from residual.calibration import calibrate as core
from residual.calibration import rows as cut
from residual.calibration.calibrate import Settings, calibrate
from residual.calibration.choice import (
    Training,
    choice_groups,
    chosen_model,
    fixed_lookup,
)
from residual.calibration.methods import (
    CHOSEN,
    DEFAULT,
    EFFECTS,
    LS,
    NONE,
    PAPER_FORM,
    PLSR,
    SPARSE,
)
from residual.calibration.nominal import identified_without, prepare_runs
from residual.calibration.rows import (
    GUARD,
    Run,
    cut_single,
    paper_rows,
    repeat_period,
    shorten,
)
from residual.calibration.scores import (
    BLOCK,
    FAMILY,
    RANDOM,
    REPEATS,
    RUN,
    SYSTEMATIC,
    find,
    make_schemes,
    ratio_interval,
)
from residual.effects import registry
from residual.errors import InputError
from residual.model.model import Term
from residual.tables.choose import fit_effect_tables
from residual.tables.components import fit_pls
from residual.tables.form import MAIN, NAMED, PAIRS, EffectForm, Option
from residual.tables.form import PLSR as PLSR_OPTION
from residual.tables.nominal_pls import NominalForm
from tests.residual.identified import logs, truth

SMALL = NominalForm(8, 6)
QUICK = Settings(form=SMALL, levels=(2, 4, 8), pairs=False)
LEAN = partial(EffectForm, pyramid=(5, 10))


@pytest.fixture(autouse=True)
def lean(monkeypatch):
    """Main effects on ten levels instead of forty: a step is a step on either."""
    monkeypatch.setattr(core, "EffectForm", LEAN)


@cache
def paper_runs(count=4, duration=6.0):
    """Runs whose twin lacks dry friction: its error is a step of the velocity."""
    out = []
    for number, log in enumerate(logs(count, noise=0.2, duration=duration)):
        # The arm is where it was asked to be.
        log = replace(log, q_ref=log.q)
        qd = np.gradient(log.q, log.t, axis=0)
        noise = np.random.default_rng(number).normal(size=log.q.shape)
        step = np.array([4.0, 5.0, 2.0]) * np.sign(qd) + 0.2 * noise
        family = ("fourier", "cyclic")[number % 2]
        out.append(Run(log, family, {"e_tau": step}))
    return tuple(out)


@cache
def made():
    settings = replace(QUICK, paper=True, schemes=(RUN, RANDOM))
    return calibrate(truth().robot, paper_runs(), settings)


def test_the_papers_rows_pair_the_reference_with_the_error_one_sample_ahead():
    runs = paper_runs()
    rows = paper_rows(runs)
    step = 2  # 250 Hz to 125
    own = rows.X[rows.run == 1]
    log, twin = runs[1].log, runs[1].twin["e_tau"]
    assert rows.names[:4] == ("q1", "q2", "q3", "qd1")
    np.testing.assert_array_equal(own[:, :3], log.q_ref[:-1:step])
    np.testing.assert_array_equal(rows.Y[rows.run == 1], twin[1::step])
    np.testing.assert_array_equal(rows.tau[rows.run == 1], log.tau[1::step])
    assert rows.rates == (125.0,) * 4


@pytest.mark.parametrize(
    ("change", "told"),
    [({"twin": {}}, "torque of a simulated twin"), ({"log": None}, "reference")],
)
def test_the_papers_mode_says_what_a_run_lacks(change, told):
    run = paper_runs()[0]
    if "log" in change:
        change = {"log": replace(run.log, q_ref=None)}
    with pytest.raises(InputError, match=f"--paper: log0 has no {told}"):
        paper_rows([replace(run, **change)])


def test_a_repetition_is_found_and_a_motion_without_one_has_no_period():
    t = np.arange(2000) / 100
    twice = np.sin(2 * np.pi * np.outer(t, [0.1, 0.2]) + [0, 1])
    assert repeat_period(twice) == 1000
    dwelling = np.clip(2 * twice, -1, 1)
    assert repeat_period(dwelling) == pytest.approx(1000, abs=1)
    assert repeat_period(np.sin(np.outer(t, [0.31, 0.77]))) is None
    assert repeat_period(np.zeros((100, 2))) is None


def test_schemes_are_those_that_the_rows_allow(rng):
    rows = paper_rows(paper_runs())
    schemes, notes = make_schemes(rows, rng)
    assert [s.name for s in schemes] == [RUN, FAMILY, SYSTEMATIC, RANDOM]
    assert notes == ("no run repeats itself: repeats cannot be kept together",)
    families = {s.name: s for s in schemes}[FAMILY]
    four = [set(range(4 * i, 4 * i + 4)) for i in range(4)]
    assert families.left_out == (four[1] | four[3], four[0] | four[2])
    unknown = replace(rows, families=("",) * 4)
    names = [s.name for s in make_schemes(unknown, rng)[0]]
    assert names == [RUN, SYSTEMATIC, RANDOM]
    with pytest.raises(InputError, match="two or more"):
        make_schemes(replace(rows, labels=("one",)), rng)


def test_repeats_are_left_out_together_where_there_are_some(rng):
    rows = paper_rows(paper_runs())
    q = np.sin(np.arange(len(rows.X)) * 2 * np.pi / 250)
    rows = replace(rows, X=np.repeat(q[:, None], 9, axis=1))
    schemes = {s.name: s for s in make_schemes(rows, rng)[0]}
    of_row = schemes[REPEATS].folds.of_row[rows.run == 0]
    np.testing.assert_array_equal(of_row[:250], of_row[250:500])


def test_a_held_out_run_is_unknown_to_the_nominal_model():
    runs = [Run(log) for log in logs(3, noise=0.5, duration=8.0)]
    strange = replace(runs[1], log=replace(runs[1].log, tau=5 * runs[1].log.tau + 9))
    models = [
        identified_without(prepare_runs(truth().robot, own, None), {4, 5, 6, 7})
        for own in (runs, [runs[0], strange, runs[2]])
    ]
    first, second = (m.coefficients() for m in models)
    np.testing.assert_array_equal(first, second)
    everything = identified_without(prepare_runs(truth().robot, runs, None))
    assert np.abs(everything.coefficients() - first).max() > 0


def test_the_table_is_what_fits_by_hand_give():
    rows, scores = made().rows, made().scores
    none = find(scores, RUN, NONE)
    by_hand = 100 * np.sqrt((rows.Y**2).sum(0) / (rows.tau**2).sum(0))
    np.testing.assert_allclose(none.rmsev, by_hand)
    np.testing.assert_allclose(none.rmsec, by_hand)
    one, miss = np.c_[np.ones(len(rows.X)), rows.X], np.zeros(3)
    for run in range(4):
        out = rows.run == run
        theta = np.linalg.lstsq(one[~out], rows.Y[~out], rcond=None)[0]
        miss += ((rows.Y[out] - one[out] @ theta) ** 2).sum(0)
    expected = 100 * np.sqrt(miss / (rows.tau**2).sum(0))
    np.testing.assert_allclose(find(scores, RUN, LS).rmsev, expected, rtol=1e-7)
    pls = find(scores, RANDOM, PLSR)
    np.testing.assert_allclose(pls.curve[-1], find(scores, RANDOM, LS).rmsev, rtol=1e-6)
    assert 1 <= pls.components <= 9
    np.testing.assert_array_equal(pls.rmsev, pls.curve[pls.components])


def test_friction_is_found_by_the_default_form_and_memorised_by_the_papers():
    scores = made().scores
    ours, theirs = (find(scores, RUN, m).overall for m in (DEFAULT, PAPER_FORM))
    ls = find(scores, RUN, LS).overall
    assert ours < 0.5 * ls
    assert theirs > 1.25 * find(scores, RANDOM, PAPER_FORM).overall
    assert [o.kind for o in made().chosen] == [MAIN] * 3


def test_levels_of_the_papers_form_are_chosen_and_few_where_friction_is_a_step():
    levels, scores = made().levels, made().scores
    assert len(levels.form.levels) == 9
    assert max(levels.form.levels) <= 8
    chosen, paper = (find(scores, RUN, m).overall for m in (CHOSEN, PAPER_FORM))
    assert chosen < paper
    sizes = tuple(len(axis.edges) + 1 for axis in made().paper.axes)
    assert sizes == levels.form.levels


def test_levels_components_and_joints_that_are_given_are_taken_as_they_are():
    form = NominalForm((2, 3, 2, 5, 6, 5), 3)
    settings = replace(QUICK, paper=True, form=form, given=True, joints=(1, 3))
    settings = replace(settings, views=False, schemes=(RUN,))
    found = calibrate(truth().robot, paper_runs(), settings)
    assert found.rows.joints == (1, 3)
    assert found.rows.names == ("q1", "q3", "qd1", "qd3", "qdd1", "qdd3")
    whole = made().rows
    np.testing.assert_array_equal(found.rows.Y, whole.Y[:, [0, 2]])
    np.testing.assert_array_equal(found.rows.X, whole.X[:, [0, 2, 3, 5, 6, 8]])
    assert tuple(len(axis.edges) + 1 for axis in found.paper.axes) == form.levels
    assert found.levels is None
    assert find(found.scores, RUN, CHOSEN) is None
    with pytest.raises(InputError, match="joints 4: expected some of 1 to 3"):
        paper_rows(paper_runs(), (4,))


def test_figures_have_what_they_need():
    views = made()
    assert [(c.family, c.block) for c in views.components][:3] == [
        ("fourier", "input"),
        ("fourier", "residual"),
        ("fourier", "white noise"),
    ]
    assert all(c.real == 0 for c in views.components if c.block == "white noise")
    assert set(views.sweep.errors) == {RUN, RANDOM}
    assert views.sweep.errors[RUN].shape == (3, 3)
    largest = views.terms.names[int(views.terms.sizes.values[:, 0].argmax())]
    assert largest == "qd1"
    assert views.terms.sizes.significant[views.terms.names.index("qd1"), 0]
    by_rows, by_run = views.terms.by_rows, views.terms.sizes
    assert (by_rows.groups, by_run.groups) == (20, 4)
    np.testing.assert_array_equal(by_rows.values, by_run.values)
    assert by_rows.significant.mean() > by_run.significant.mean()
    assert all(0 <= share <= 1 for share in views.oddities.unvisited)
    assert np.shape(views.oddities.by_class) == (4, 3)


def test_the_run_of_figure_9_is_corrected_by_fits_that_have_not_seen_it():
    unseen, rows = made().unseen, made().rows
    number = rows.labels.index(unseen.label)
    out = rows.run == number
    step = round(unseen.t[1] * rows.rates[number])
    np.testing.assert_array_equal(unseen.left, rows.Y[out][::step])
    rest = unseen.left - unseen.corrections["default"]
    assert np.linalg.norm(rest) < 0.5 * np.linalg.norm(unseen.left)
    # Least squares by hand on the other runs.
    one = np.c_[np.ones(len(rows.X)), rows.X]
    theta = [
        np.linalg.lstsq(one[~out & moves], y[~out & moves], rcond=None)[0]
        for y, moves in zip(rows.Y.T, rows.moving.T, strict=True)
    ]
    by_hand = (one[out] @ np.column_stack(theta))[::step]
    np.testing.assert_allclose(unseen.corrections["ls"], by_hand, atol=1e-6)
    assert unseen.t[-1] == pytest.approx(6, abs=0.2)


def training(runs=3, rows=400, seed=0):
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(runs), rows)
    X = rng.normal(size=(len(run), 6))
    noise = rng.normal(size=(len(run), 2))
    Y = np.stack([3 * np.sign(X[:, 2]), np.zeros(len(run))], axis=1) + 0.3 * noise
    part = np.arange(len(run)) * 4 // rows
    second = np.arange(len(run)) // 20
    return Training(X, Y, run, Y + rng.normal(size=Y.shape), part, second)


FORM = EffectForm((2, 3), pyramid=(5, 10), pairs=NominalForm(5, 3, "quantile"))


def test_tables_of_given_options_are_those_of_the_choice():
    data = training()
    model = fit_effect_tables(data.X, data.Y, data.run, data.tau, FORM)
    again = fixed_lookup(data, FORM, model.chosen)
    np.testing.assert_allclose(
        again.predict(data.X), model.lookup.predict(data.X), atol=1e-12
    )
    both = (Option(PAIRS, 10.0, 2), Option(NAMED, 10.0, 1))
    assert np.isfinite(fixed_lookup(data, FORM, both).predict(data.X)).all()


def test_nothing_is_taken_for_pure_noise():
    model, options = chosen_model(training(), FORM)
    assert [o.kind for o in options] == [MAIN, "none"]
    assert options == model.chosen


def standing(seed=0):
    """Noise, and at standstill friction that one sees in no other motion."""
    data = training(4, seed=seed)
    moving = abs(data.X[:, 2:4]) > 0.4
    noise = np.random.default_rng(seed + 1).normal(size=data.Y.shape)
    still = -4 * np.sign(data.X[:, 2:4])
    return replace(data, Y=np.where(moving, 0.1 * noise, still)), moving


def test_a_line_and_a_step_in_motion_are_taught_at_standstill_too():
    data, moving = standing()
    friction = data.X @ np.ones((6, 2)) + 2 * np.sign(data.X[:, 2:4])
    mixed = replace(data, Y=np.where(moving, friction, data.Y), moving=moving)
    taught = mixed.taught()
    np.testing.assert_allclose(taught.Y, friction, atol=1e-9)
    np.testing.assert_allclose(taught.loaded, mixed.loaded, atol=1e-12)
    np.testing.assert_allclose(taught.taught().Y, taught.Y, atol=1e-12)


def test_what_is_left_at_standstill_alone_is_no_table():
    data, moving = standing()
    kinds = [o.kind for o in chosen_model(data, FORM)[1]]
    assert "none" not in kinds
    _, options = chosen_model(replace(data, moving=moving), FORM)
    assert [o.kind for o in options] == ["none", "none"]


def test_of_fewer_than_four_runs_blocks_are_left_out():
    data = training(2)
    np.testing.assert_array_equal(choice_groups(data), data.part)
    np.testing.assert_array_equal(choice_groups(training()), training().part)
    np.testing.assert_array_equal(choice_groups(training(4)), training(4).run)
    asked = []

    def without(parts):
        asked.append(tuple(parts))
        return data.Y

    _, options = chosen_model(replace(data, without=without), FORM)
    assert [o.kind for o in options] == [MAIN, "none"]
    assert asked == [(part,) for part in range(8)]


def test_what_holds_in_one_run_alone_is_not_taken_and_a_straight_line_is_a_line():
    data = training(2)
    # Linear in a variable whose range is another one in each run.
    X = data.X.copy()
    X[:, 0] += 50 * data.run
    slope = np.where(data.run == 0, 3.0, -3.0) * (X[:, 0] - 50 * data.run)
    Y = np.stack([slope, np.zeros(len(X))], axis=1) + 0.01 * data.Y
    linear = replace(data, X=X, Y=Y)
    lines = {"least squares", "plsr"}
    assert not {o.kind for o in chosen_model(linear, FORM)[1]} & lines
    # A step that the other run has the other way round.
    turned = np.where(data.run[:, None] == 0, data.Y, -data.Y)
    _, options = chosen_model(replace(data, Y=turned), FORM)
    assert options[0].kind == "none"
    straight = replace(data, Y=2 * data.X[:, :2], tau=5 * data.X[:, :2])
    _, options = chosen_model(straight, FORM)
    assert {o.kind for o in options} <= lines


def test_the_best_of_what_anyone_would_try_is_taken_unless_by_chance():
    """No joint gets what loses to nothing, least squares or PLSR on left-out blocks."""
    rng = np.random.default_rng(5)
    data = training(3, rows=600)
    slope = rng.normal(size=(6, 2))
    for Y in (data.X @ slope, data.Y, rng.normal(size=data.Y.shape)):
        own = replace(data, Y=Y + 0.5 * rng.normal(size=Y.shape))
        tables = chosen_model(own, FORM)[1]
        left = {"ours": 0.0, "none": 0.0, "line": 0.0}
        for part in np.unique(own.part):
            kept, new = own.rows(own.part != part), own.rows(own.part == part)
            one = np.c_[np.ones(len(kept.X)), kept.X]
            theta = np.linalg.lstsq(one, kept.Y, rcond=None)[0]
            line = np.c_[np.ones(len(new.X)), new.X] @ theta
            ours = fixed_lookup(kept, FORM, tables).predict(new.X)
            left["ours"] += ((new.Y - ours) ** 2).sum(axis=0)
            left["none"] += (new.Y**2).sum(axis=0)
            left["line"] += ((new.Y - line) ** 2).sum(axis=0)
        assert (left["ours"] <= 1.02**2 * np.minimum(left["none"], left["line"])).all()


def test_plsr_of_given_components_is_that_of_its_scores():
    data = training()
    options = (Option(PLSR_OPTION, count=2), Option("none"))
    pls = fit_pls(data.X, data.Y)
    by_scores = data.Y.mean(axis=0) + pls.transform(data.X)[:, :2] @ pls.Q.T[:2]
    got = fixed_lookup(data, FORM, options).predict(data.X)
    np.testing.assert_allclose(got[:, 0], by_scores[:, 0], atol=1e-9)
    np.testing.assert_array_equal(got[:, 1], 0)


def test_dense_and_sparse_pair_tables_stand_side_by_side():
    scores = made().scores
    dense, sparse = (find(scores, RUN, m) for m in (PAPER_FORM, SPARSE))
    assert 1 <= sparse.components <= len(sparse.curve) - 1
    assert sparse.overall != dense.overall


@cache
def few_runs():
    """Two runs of an arm whose dry friction its model lacks."""
    declared = ("viscous", "rotor_inertia")
    settings = replace(QUICK, declared=declared, views=False, schemes=(RUN, BLOCK))
    runs = [Run(log) for log in logs(2, noise=0.3, duration=6.0)]
    return calibrate(truth().robot, runs, settings)


def test_where_runs_are_few_blocks_are_left_out_and_an_unseen_run_is_no_empty_proof(
    rng,
):
    found = few_runs()
    every = [s.name for s in make_schemes(found.rows, rng)[0]]
    assert every == [RUN, BLOCK, SYSTEMATIC, RANDOM]
    assert [s.name for s in found.schemes] == [RUN, BLOCK]
    assert "2 runs are few" in found.notes[0]
    for scheme, folds in ((RUN, 2), (BLOCK, 8)):
        none, ours = (find(found.scores, scheme, m) for m in (NONE, DEFAULT))
        assert none.miss.shape == (folds, 3)
        assert ours.overall < 0.8 * none.overall
        ratio = ratio_interval(ours, none, np.random.default_rng(0))
        assert ratio.value == pytest.approx(ours.overall / none.overall)
        assert ratio.low < ratio.value < ratio.high < 1
        assert ratio.folds == folds
    assert "unseen blocks of the same runs" in " ".join(sentences(found))


def test_what_is_close_to_a_block_is_neither_fitted_nor_identified_from():
    rows = few_runs().rows
    scheme = next(s for s in few_runs().schemes if s.name == BLOCK)
    held, fitted = scheme.folds.of_row == 1, scheme.fitted(1)
    between = np.flatnonzero(~held & ~fitted)
    width = GUARD * rows.rates[0]
    assert len(between) == pytest.approx(2 * width, abs=2)
    assert set(rows.part[between]) == {0, 2}
    inside = np.flatnonzero(held)
    apart = np.abs(between[:, None] - inside).min(axis=1)
    assert apart.max() <= width + 1
    runs = [Run(log) for log in logs(3, noise=0.5, duration=8.0)]
    begin, end = (int(250 * s) for s in (2.6, 3.7))
    tau = runs[0].log.tau.copy()
    tau[begin:end] *= 5
    prepared = [
        prepare_runs(truth().robot, own, ("viscous",))
        for own in (
            runs,
            [replace(runs[0], log=replace(runs[0].log, tau=tau)), *runs[1:]],
        )
    ]
    part = prepared[0].parts[1]
    assert part.begin < 2.5
    assert part.end > 3.8
    first, second = (identified_without(p, {1}).coefficients() for p in prepared)
    np.testing.assert_allclose(first, second, rtol=0.02, atol=0.02)
    spoiled = identified_without(prepared[1]).coefficients()
    assert np.abs(spoiled - first).max() > 10 * np.abs(second - first).max()


def test_a_choice_that_other_nominal_models_do_not_bear_out_is_dropped():
    data = training()
    # Without any one run the model leaves the opposite of what tables then learn.
    flipped = np.where(data.run[:, None] == 1, -data.Y, data.Y)
    flipped[data.run == 2] = 0.0
    _, options = chosen_model(replace(data, without=lambda run: flipped), FORM)
    assert options[0].kind == "none"


def test_a_single_log_is_cut_into_parts_and_effects_of_a_diagnosis_are_judged():
    (log,) = logs(1, noise=0.3, duration=9.0)
    settings = replace(QUICK, declared=("viscous", "rotor_inertia"), views=False)
    settings = replace(settings, schemes=(RUN,))
    coulomb = registry()["coulomb"]
    terms = [Term(coulomb, (j,), (), np.array([4.0])) for j in range(3)]
    found = calibrate(truth().robot, [Run(log)], settings, terms)
    assert found.rows.labels[0] == "log0 part 1"
    assert "cut into parts" in found.notes[0]
    named, none = (find(found.scores, RUN, m) for m in (EFFECTS, NONE))
    assert named.overall < 0.5 * none.overall
    assert len(cut_single([Run(log)] * 2)) == 2


def test_named_effects_keep_their_shapes_and_are_fitted_anew():
    prepared = prepare_runs(truth().robot, [Run(log) for log in logs(2)], None)
    named = Term(registry()["stribeck"], (1,), (0.05, 2.0), np.array([99.0]))
    model = identified_without(prepared, (), [named])
    (term,) = [t for t in model.terms if t.effect is named.effect]
    assert (term.joints, term.shape) == ((1,), (0.05, 2.0))
    assert abs(term.theta[0]) < 20


def test_of_logs_that_are_too_long_the_middles_are_taken_in_step_with_their_twins(
    monkeypatch,
):
    runs = paper_runs()
    assert shorten(runs) == (runs, ())
    total = sum(run.log.duration for run in runs)
    monkeypatch.setattr(cut, "MOST", 0.4 * total)
    kept, (note,) = shorten(runs)
    assert "the middle 40 %" in note
    for run, own in zip(runs, kept, strict=True):
        assert own.log.id == run.log.id
        assert len(own.log.t) == int(0.4 * len(run.log.t))
        first = int(np.searchsorted(run.log.t, own.log.t[0]))
        rows = slice(first, first + len(own.log.t))
        np.testing.assert_array_equal(own.log.tau, run.log.tau[rows])
        np.testing.assert_array_equal(own.log.q_ref, run.log.q_ref[rows])
        np.testing.assert_array_equal(own.twin["e_tau"], run.twin["e_tau"][rows])
        beside = len(run.log.t) - rows.stop - first
        assert abs(beside) <= 1  # as much before as behind


def test_long_logs_identify_the_model_whole_and_tables_take_fewer_rows(monkeypatch):
    runs = [Run(log) for log in logs(3, noise=0.5, duration=4.0)]
    settings = replace(QUICK, views=False, schemes=())
    whole = calibrate(truth().robot, runs, settings)
    monkeypatch.setattr(cut, "MOST", 4.5)
    thin = calibrate(truth().robot, runs, settings)
    assert any("one row in 3" in note for note in thin.notes)
    assert len(thin.rows.X) == pytest.approx(len(whole.rows.X) / 3, abs=3)
    np.testing.assert_array_equal(
        thin.nominal.coefficients(), whole.nominal.coefficients()
    )
    last = [rows.X[rows.run == 2][-1] for rows in (whole.rows, thin.rows)]
    assert np.abs(last[0] - last[1]).max() < 1.0  # its end is there too
