"""What one sees who knows the truth: a planted torque, and the parameters beside it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.diagnosis_parts.cases import make, the_arm
from benchmarks.diagnosis_parts.power import power, true_torque
from residual.evidence.design import Design
from residual.evidence.fit import autocorrelation_time
from residual.method.diagnose import diagnose
from residual.model.nominal import declared_names, prepare_logs, start_nominal
from residual.robot.dynamics import inverse_dynamics
from residual.signals.splitting import session_clock
from residual.signals.track import Filters

JOINT = 2  # from 0


@cache
def _bare():
    return make("quick", (), 3, 3).fit


def _planted(torque):
    """The same logs with a torque of the motion on top: angles (n, dof) to (n, dof)."""
    return tuple(replace(r, tau=r.tau + torque(r.q)) for r in _bare())


def _wave(size):
    def torque(q):
        out = np.zeros_like(q)
        out[:, JOINT] = size * np.sign(np.cos(25 * q[:, JOINT]))
        return out

    return torque


def _prepared(recordings):
    clock = session_clock(recordings)
    return prepare_logs(the_arm(), recordings, clock, Filters())


def test_without_anything_hidden_there_is_nothing_to_see():
    seen = power(the_arm(), _bare(), _bare())
    assert seen.nats < 0  # the price of a name, for nothing
    assert not seen.sees


def test_a_planted_torque_is_read_back_as_it_is():
    planted = _planted(_wave(1.5))
    logs = _prepared(_bare())
    nominal = start_nominal(logs, declared_names(the_arm(), None))
    pair, track = (planted[0], _bare()[0]), logs.tracks[0]
    made = true_torque(nominal.model, pair, (track, track))
    there = np.interp(track.t, pair[0].t, pair[0].tau[:, JOINT] - pair[1].tau[:, JOINT])
    np.testing.assert_allclose(made[:, JOINT], there, atol=1e-9)
    assert np.abs(np.delete(made, JOINT, axis=1)).max() < 1e-9


def test_its_evidence_is_that_of_the_squares_it_removes():
    """Against least squares by hand, without priors: n / 2 ln(sse / sse with it)."""
    planted = _planted(_wave(1.0))
    seen = power(the_arm(), planted, _bare())
    logs, bare = _prepared(planted), _prepared(_bare())
    nominal = start_nominal(logs, declared_names(the_arm(), None))
    design = Design(logs.tracks, nominal.model)
    place, _ = design.present(JOINT, design.nominal)
    rows = [t.moving[:, JOINT] for t in logs.tracks]
    pairs = zip(logs.tracks, bare.tracks, rows, strict=True)
    e = np.concatenate([(a.tau - b.tau)[use, JOINT] for a, b, use in pairs])
    columns, y = design.columns(JOINT, place), design.target[JOINT]
    both = (columns, np.column_stack([columns, e]))
    left = [y - x @ np.linalg.lstsq(x, y, rcond=None)[0] for x in both]
    counted = len(y) / autocorrelation_time(design.line(JOINT, left[1]))
    most = 0.5 * counted * np.log((left[0] @ left[0]) / (left[1] @ left[1]))
    # Free of their priors the parameters fit noise, more so beside the column; and the
    # vocabulary has its price. So it is less, and of this order.
    assert 0.5 * most < seen.nats < most
    assert seen.sees


def test_what_a_parameter_says_as_well_is_seen_by_nobody():
    """One body that is a little heavier, well within what descriptions are off by."""
    robot = the_arm()
    heavy = robot.model.copy()
    heavy.inertias[3].mass *= 1.01

    def torque(q):
        still = np.zeros_like(q)
        return inverse_dynamics(heavy, q, still, still) - inverse_dynamics(
            robot.model, q, still, still
        )

    assert not power(robot, _planted(torque), _bare()).sees


@pytest.mark.long
@pytest.mark.parametrize(("joint", "share"), [(0, 0.033), (1, 0.025)])
def test_a_dead_zone_that_shows_is_said_to_be_there(joint, share):
    """It has no name, so its joint is flagged: 2.6 times the noise is left of it."""

    def logs(recordings):
        for one in recordings:
            tau = one.tau.copy()
            level = share * tau[:, joint].std() * 1.5
            tau[:, joint] -= np.clip(tau[:, joint], -level, level)
            yield replace(one, tau=tau)

    made = make("quick", (), 3, 3)
    fit, held_out = tuple(logs(made.fit)), tuple(logs(made.held_out))
    verdict = diagnose(made.robot, fit, (), held_out).verdict
    assert power(made.robot, fit, made.fit).sees
    assert joint + 1 in verdict.unexplained.joints
