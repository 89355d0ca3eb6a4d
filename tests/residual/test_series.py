"""A spring and ripples that draw a curve are no names; those that are there are."""

import numpy as np
import pytest

from residual.diagnosis import gate
from residual.diagnosis.gate import find_replaceable_by_curve
from residual.effects import load_effects
from residual.evidence.design import Design
from residual.evidence.fit import fit_jointly
from residual.model.model import Model
from residual.robot.dynamics import read_inertial_parameters
from residual.signals.track import FilterSettings, build_tracks
from tests.residual.arms import arm, plain_logs
from tests.residual.linear import nominal_prior


@pytest.fixture
def judged(rng):
    def judge(shape, names):
        logs = []
        for log in plain_logs(arm(), [0, 1], [0.0, 0.0]):
            tau = log.tau.copy()
            tau[:, 1] += shape(log.q[:, 1])
            logs.append(type(log)(log.id, log.robot, log.t, log.q, tau))
        tracks, floor = build_tracks(logs, FilterSettings())
        model = Model(arm(), read_inertial_parameters(arm().model), (), floor)
        design = Design(tracks, model)
        wanted = [(load_effects()[name], (1,), order) for name, order in names]
        # Friction of the logs is no part of the question.
        wanted += [(load_effects()[n], (1,), ()) for n in ("coulomb", "viscous")]
        groups = design.add(wanted)
        fitted = fit_jointly(design, nominal_prior(rng), groups, design.rows, rounds=5)
        tested = [gate.GateResult(g, 99.0, "fit", 1, 0.1, 0.9, 1) for g in groups]
        out = find_replaceable_by_curve(design, tracks, fitted, tested)
        return [t.group.effect.name for t in out]

    return judge


def test_names_that_together_draw_a_stop_are_a_curve(judged):
    series = [("spring", ()), ("ripple", (3.1,)), ("ripple", (5.2,))]
    stop = judged(lambda q: 12 * np.maximum(q - 0.2, 0), series)
    assert stop == ["spring", "ripple", "ripple"]


def test_a_spring_and_a_ripple_that_are_there_stand(judged):
    both = [("spring", ()), ("ripple", (24.0,))]
    assert judged(lambda q: 4 * q + 1.5 * np.cos(24 * q), both) == []
