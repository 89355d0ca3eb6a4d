"""The paper's chapter on runs: rows, schemes, table and what it must not hide."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.model_selection import LeaveOneGroupOut

from flows.report.calibration import describe_calibration
from residual.calibration import correction_choice
from residual.calibration.calibrate import CalibrationSettings, calibrate, prepare_runs
from residual.calibration.calibrate import identify_without_blocks as without_blocks
from residual.calibration.calibration_rows import GUARD, CalibrationRun, build_paper_rows
from residual.calibration.correction_choice import (
    MAIN,
    PAIRS,
    CorrectionOption,
    choose_table_levels,
)
from residual.calibration.correction_choice import list_correction_options as correction_options
from residual.calibration.nominal_pls import NominalPlsForm
from residual.calibration.validation_scores import (
    BLOCK,
    DEFAULT,
    FAMILY,
    LS,
    NOTHING,
    PAPER_FORM,
    PLSR,
    RANDOM,
    RUN,
    SYSTEMATIC,
    build_validation_schemes,
    choose_fold_options,
    cross_validate_corrections,
)
from residual.calibration.validation_scores import find_model_score as model_score
from residual.errors import InputError
from tests.residual.identified import logs, truth

SMALL = NominalPlsForm(8, 6)
QUICK = CalibrationSettings(form=SMALL)


@pytest.fixture(autouse=True)
def lean(monkeypatch):
    """Tables of ten levels instead of twenty: a step is a step on either."""
    monkeypatch.setattr(correction_choice, "LEVELS", 10)


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
        out.append(CalibrationRun(log, family, {"e_tau": step}))
    return tuple(out)


@cache
def paper_calibration():
    settings = replace(QUICK, paper=True, schemes=(RUN, RANDOM))
    return calibrate(truth().robot, paper_runs(), settings)


def test_the_papers_rows_pair_the_reference_with_the_error_one_sample_ahead():
    runs = paper_runs()
    rows = build_paper_rows(runs)
    step = 2  # 250 Hz to 125
    own = rows.X[rows.run == 1]
    log, twin = runs[1].log, runs[1].twin["e_tau"]
    assert rows.names[:4] == ("q1", "q2", "q3", "qd1")
    np.testing.assert_array_equal(own[:, :3], log.q_ref[:-1:step])
    np.testing.assert_array_equal(rows.Y[rows.run == 1], twin[1::step])
    np.testing.assert_array_equal(rows.tau[rows.run == 1], log.tau[1::step])
    assert rows.rates == (125.0,) * 4


def test_schemes_are_those_that_the_rows_allow(rng):
    rows = build_paper_rows(paper_runs())
    schemes, notes = build_validation_schemes(rows, rng)
    assert [s.name for s in schemes] == [RUN, FAMILY, SYSTEMATIC, RANDOM]
    assert notes == ()
    families = {s.name: s for s in schemes}[FAMILY]
    four = [set(range(4 * i, 4 * i + 4)) for i in range(4)]
    assert families.left_out == (four[1] | four[3], four[0] | four[2])
    _, _, systematic, drawn = (scheme.fold for scheme in schemes)
    assert (np.diff(systematic) >= 0).all()
    for fold in (systematic, drawn):
        assert np.ptp(np.bincount(fold, minlength=20)) <= 1
    splits = LeaveOneGroupOut().split(rows.X, groups=rows.run)
    for ours, theirs in zip(schemes[0].split(rows), splits, strict=True):
        for mask, numbers in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(np.flatnonzero(mask), numbers)
    unknown = replace(rows, families=("",) * 4)
    names = [s.name for s in build_validation_schemes(unknown, rng)[0]]
    assert names == [RUN, SYSTEMATIC, RANDOM]
    with pytest.raises(InputError, match="two or more"):
        build_validation_schemes(replace(rows, labels=("one",)), rng)
    part = np.arange(0, len(rows.X), len(rows.X) // 11)
    few = {name: getattr(rows, name)[part] for name in ("X", "run", "place")}
    with pytest.raises(InputError, match=r"blocks must be .*There are 12 rows"):
        build_validation_schemes(replace(rows, **few), rng)


def test_a_held_out_run_is_unknown_to_the_nominal_model():
    runs = [CalibrationRun(log) for log in logs(3, noise=0.5, duration=8.0)]
    strange = replace(runs[1], log=replace(runs[1].log, tau=5 * runs[1].log.tau + 9))
    models = [
        without_blocks(prepare_runs(truth().robot, own, None), {4, 5, 6, 7})
        for own in (runs, [runs[0], strange, runs[2]])
    ]
    first, second = (m.coefficients() for m in models)
    np.testing.assert_array_equal(first, second)
    everything = without_blocks(prepare_runs(truth().robot, runs, None))
    assert np.abs(everything.coefficients() - first).max() > 0


def test_the_table_is_what_fits_by_hand_give():
    rows, scores = paper_calibration().rows, paper_calibration().scores
    none = model_score(scores, RUN, NOTHING)
    by_hand = 100 * np.sqrt((rows.Y**2).sum(0) / (rows.tau**2).sum(0))
    assert_allclose(none.rmsev, by_hand)
    assert_allclose(none.rmsec, by_hand)
    one, miss = np.c_[np.ones(len(rows.X)), rows.X], np.zeros(3)
    for run in range(4):
        out = rows.run == run
        theta = np.linalg.lstsq(one[~out], rows.Y[~out], rcond=None)[0]
        miss += ((rows.Y[out] - one[out] @ theta) ** 2).sum(0)
    expected = 100 * np.sqrt(miss / (rows.tau**2).sum(0))
    assert_allclose(model_score(scores, RUN, LS).rmsev, expected, rtol=1e-7)
    pls = model_score(scores, RANDOM, PLSR)
    assert_allclose(pls.curve[-1], model_score(scores, RANDOM, LS).rmsev, rtol=1e-6)
    assert 1 <= pls.components <= 9
    np.testing.assert_array_equal(pls.rmsev, pls.curve[pls.components])


def test_friction_is_found_by_the_default_form_and_memorised_by_the_papers():
    scores = paper_calibration().scores
    ours, theirs = (model_score(scores, RUN, m).overall for m in (DEFAULT, PAPER_FORM))
    assert ours < 0.5 * model_score(scores, RUN, LS).overall
    assert theirs > 1.25 * model_score(scores, RANDOM, PAPER_FORM).overall
    assert {o.kind for o in paper_calibration().chosen} <= {MAIN, PAIRS}


def test_the_run_of_figure_9_is_corrected_by_fits_that_have_not_seen_it():
    unseen, rows = paper_calibration().unseen, paper_calibration().rows
    number = rows.labels.index(unseen.label)
    out = rows.run == number
    step = round(unseen.t[1] * rows.rates[number])
    np.testing.assert_array_equal(unseen.residual, rows.Y[out][::step])
    rest = unseen.residual - unseen.corrections["default"]
    assert np.linalg.norm(rest) < 0.5 * np.linalg.norm(unseen.residual)
    # Least squares by hand on the other runs.
    one = np.c_[np.ones(len(rows.X)), rows.X]
    theta = [
        np.linalg.lstsq(one[~out & moves], y[~out & moves], rcond=None)[0]
        for y, moves in zip(rows.Y.T, rows.moving.T, strict=True)
    ]
    by_hand = (one[out] @ np.column_stack(theta))[::step]
    assert_allclose(unseen.corrections["ls"], by_hand, atol=1e-6)
    assert unseen.t[-1] == pytest.approx(6, abs=0.2)


def test_the_choice_for_a_fold_does_not_know_its_errors():
    rows = build_paper_rows(paper_runs())
    schemes, _ = build_validation_schemes(rows, np.random.default_rng(0))
    names = (*rows.names, "tau1", "tau2", "tau3")
    tables = choose_table_levels(rows.X, rows.tau - rows.Y, rows.velocity_columns, names)
    args = (lambda _: rows.Y, tables, correction_options(9), None)
    lead = cross_validate_corrections(schemes[0], rows, *args)
    first = choose_fold_options(lead, lead, rows)
    own = np.unique(rows.second[rows.run == 2])
    seconds = lead.seconds.copy()
    # On run 2 nothing is wrong with doing nothing.
    seconds[:, own] = 1e6
    seconds[0, own] = 0.0
    other = choose_fold_options(lead, replace(lead, seconds=seconds), rows)
    assert other[2] == first[2]
    assert set(other[0]) == {CorrectionOption("none")}


@cache
def few_runs():
    declared = ("viscous", "rotor_inertia")
    given = replace(QUICK, declared=declared, with_figures=False, schemes=(RUN, BLOCK))
    runs = [CalibrationRun(log) for log in logs(2, noise=0.3, duration=6.0)]
    return calibrate(truth().robot, runs, given)


def test_where_runs_are_few_blocks_are_left_out_and_chosen_by(rng):
    calibration = few_runs()
    every = [s.name for s in build_validation_schemes(calibration.rows, rng)[0]]
    assert every == [RUN, BLOCK, SYSTEMATIC, RANDOM]
    assert list(dict.fromkeys(s.scheme for s in calibration.scores)) == [RUN, BLOCK]
    assert not calibration.proven
    assert "2 runs are few" in calibration.notes[0]
    for scheme, folds in ((RUN, 2), (BLOCK, 8)):
        none, ours = (model_score(calibration.scores, scheme, m) for m in (NOTHING, DEFAULT))
        assert none.miss.shape == (folds, 3)
        assert ours.overall < 0.8 * none.overall
    assert "unseen blocks of the same runs" in " ".join(describe_calibration(calibration))


def test_what_is_close_to_a_block_is_neither_fitted_nor_identified_from():
    rows = few_runs().rows
    schemes = {s.name: s for s in build_validation_schemes(rows, np.random.default_rng(0))[0]}
    fitted, held = list(schemes[BLOCK].split(rows))[1]
    between = np.flatnonzero(~held & ~fitted)
    width = GUARD * rows.rates[0]
    assert len(between) == pytest.approx(2 * width, abs=2)
    assert set(rows.place[between] // 3) == {0, 2}
    apart = np.abs(between[:, None] - np.flatnonzero(held)).min(axis=1)
    assert apart.max() <= width + 1
    runs = [CalibrationRun(log) for log in logs(3, noise=0.5, duration=8.0)]
    begin, end = (int(250 * s) for s in (2.6, 3.7))
    tau = runs[0].log.tau.copy()
    tau[begin:end] *= 5
    prepared = [
        prepare_runs(truth().robot, own, ("viscous",))
        for own in (runs, [replace(runs[0], log=replace(runs[0].log, tau=tau)), *runs[1:]])
    ]
    start, end = prepared[0].blocks.cut_times[0][:2]
    assert start < 2.5
    assert end > 3.8
    first, second = (without_blocks(p, {1}).coefficients() for p in prepared)
    assert_allclose(first, second, rtol=0.02, atol=0.02)
    spoiled = without_blocks(prepared[1]).coefficients()
    assert np.abs(spoiled - first).max() > 10 * np.abs(second - first).max()


def test_a_joint_that_moves_in_one_run_alone_is_refused_by_name():
    runs = [CalibrationRun(log) for log in logs(3, duration=6.0)]
    still = [
        replace(run, log=replace(run.log, q_ref=run.log.q * [1, number == 1, 1]))
        for number, run in enumerate(runs)
    ]
    still = [replace(run, twin={"e_tau": run.log.tau}) for run in still]
    with pytest.raises(InputError, match=r"all but run log1, .* q2 = 0"):
        calibrate(truth().robot, still, replace(QUICK, paper=True))
