"""A spring and ripples that draw a curve are no names; those that are there are."""

import numpy as np
import pytest

from residual.diagnosis import gate, outcome
from residual.diagnosis.gate import only_curves
from residual.effects import registry
from residual.evidence.design import Design
from residual.evidence.fit import fit
from residual.model.model import Model
from residual.robot.dynamics import inertial_parameters
from residual.signals.track import Filters, prepare
from sim.engine.records import Hidden
from tests.residual.arms import arm, doubts, plain_logs, short_case
from tests.residual.linear import nominal_prior


@pytest.fixture
def judged(rng):
    def judge(shape, names):
        logs = []
        for log in plain_logs(arm(), [0, 1], [0.0, 0.0]):
            tau = log.tau.copy()
            tau[:, 1] += shape(log.q[:, 1])
            logs.append(type(log)(log.id, log.robot, log.t, log.q, tau))
        tracks, floor = prepare(logs, Filters())
        model = Model(arm(), inertial_parameters(arm().model), (), floor)
        design = Design(tracks, model)
        wanted = [(registry()[name], (1,), order) for name, order in names]
        # Friction of the logs is no part of the question.
        wanted += [(registry()[n], (1,), ()) for n in ("coulomb", "viscous")]
        groups = design.add(wanted)
        fitted = fit(design, nominal_prior(rng), groups, design.rows, rounds=5)
        tested = [gate.Tested(g, 99.0, "fit", 1, 0.1, 0.9, 1) for g in groups]
        out = only_curves(design, tracks, fitted, tested)
        return [t.group.effect.name for t in out]

    return judge


def stop(q):
    return 12 * np.maximum(q - 0.2, 0)


def test_names_that_together_draw_a_stop_are_a_curve(judged):
    series = [("spring", ()), ("ripple", (3.1,)), ("ripple", (5.2,))]
    assert judged(stop, series) == ["spring", "ripple", "ripple"]


def test_a_spring_and_a_ripple_that_are_there_stand(judged):
    both = [("spring", ()), ("ripple", (24.0,))]
    assert judged(lambda q: 4 * q + 1.5 * np.cos(24 * q), both) == []


def test_two_ripples_that_are_there_stand(judged):
    both = [("ripple", (24.0,)), ("ripple", (35.0,))]
    assert judged(lambda q: np.cos(24 * q) + np.sin(35 * q), both) == []


def test_one_name_alone_is_never_asked(judged):
    assert judged(stop, [("spring", ())]) == []


def test_what_only_draws_a_curve_is_not_asked_for_its_form_as_well(monkeypatch):
    # It is out of the fit by then.
    spring = Hidden("spring", (1,), {"stiffness": 20.0, "rest": 0.2})
    case = short_case(arm(), spring, seed=63, baseline=False)
    monkeypatch.setattr(outcome, "only_curves", lambda *of: list(of[-1]))
    examined, named = doubts(case)
    assert named == []
    assert [t.group.effect.name for t in examined.withdrawn] == ["spring"]
