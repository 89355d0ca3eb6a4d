"""The motion that is found: better than where it began, and within all limits."""

import numpy as np
import pytest

from flows.steps.planning.design import (
    RANDOM,
    Form,
    apart_by_no_motion,
    design,
    document,
    improve,
)
from flows.steps.planning.motions import (
    FOURIER,
    Search,
    drawn,
    drawn_places,
    fourier,
    moves_plan,
    with_twins,
)
from residual.planning.promise import SURE, promised
from residual.robot.dynamics import inverse_dynamics
from sim.engine.geometry import MARGIN, body, clearances
from sim.engine.records import TrajectorySpec
from sim.trajectories import make_reference
from sim.trajectories.fourier import written
from tests.residual.planning.asked import asked


@pytest.fixture(scope="module")
def search():
    robot, question = asked("spring", 2)
    return with_twins(Search(question, robot, 12.0, seed=3))


@pytest.fixture(scope="module")
def better(search):
    """A start, and what a short local search makes of it."""
    place, series = drawn(search, 1)[0]
    return place, series, improve(search, place, series, 90)


def test_a_local_search_finds_a_motion_that_promises_more(search, better):
    place, start, found = better
    before, after = (Form(search, place).seconds(s) for s in (start, found))
    assert 1.0 < after < before / 1.2


def test_what_is_found_keeps_all_limits_over_the_whole_motion(search, better):
    """At 2 kHz, which is finer than the checks that it was planned with."""
    place, _, found = better
    spec = fourier(search, place, found).spec
    robot = search.robot
    motion = make_reference(robot, spec, 2000.0)
    assert motion.t[-1] == 12.0
    assert (motion.q >= robot.lower).all()
    assert (motion.q <= robot.upper).all()
    assert (np.abs(motion.qd) <= robot.velocity_limit).all()
    torque = inverse_dynamics(robot.model, motion.q, motion.qd, motion.qdd)
    assert (np.abs(torque) <= robot.torque_limit).all()
    assert clearances(body(robot.model), motion.q[::10]).min() >= MARGIN
    for end in (0, -1):
        assert np.abs(motion.qd[end]).max() < 1e-6
        assert np.abs(motion.qdd[end]).max() < 1e-5


def test_a_design_is_compared_with_what_was_not_designed(search, monkeypatch):
    monkeypatch.setattr("flows.steps.planning.design.MANY", 6)
    monkeypatch.setattr("flows.steps.planning.design._LOOKS", 70)
    made = design(search)
    best = made.best
    names = [c.name for c in made.compared]
    assert names[0] == RANDOM
    assert {"cyclic", "welding", "move_stop_move"} & set(names)
    usual = {c.name: c.seconds for c in made.compared}
    assert 1.0 < best.after < (usual[RANDOM] or np.inf)
    assert SURE <= best.sure.chance <= 1
    plan = document(made, "p.csv")
    keys = {"rivals", "family", "parameters", "seconds", "sure_after", "program"}
    assert set(plan) == keys | {"expected_nats", "chance"}
    assert {r["name"] for r in plan["rivals"]} == {"spring", "balancer"}
    spec = TrajectorySpec.from_record(
        {"kind": plan["family"], "duration": plan["seconds"], **plan["parameters"]}
    )
    again = make_reference(search.robot, spec, 100.0)
    first = make_reference(search.robot, made.best.spec, 100.0)
    np.testing.assert_array_equal(again.q, first.q)


def test_moves_stand_while_the_filter_settles_and_go_round_within_the_limits(search):
    space, edge = search.workspace(), search.question.signals.edge
    plans = [moves_plan(search, space, p, edge) for p in drawn_places(search, 12)]
    spec, plan = next(p for p in plans if p is not None)
    q, qd, _ = plan.curve(np.linspace(0, spec.duration, 4000))
    standing = np.linspace(0, spec.duration, 4000) < edge
    assert (qd[standing] == 0).all()
    places = np.array(spec.coefficients)
    for place in places:  # it comes through all of them
        assert np.abs(q - place).max(axis=1).min() < 0.05
    np.testing.assert_allclose(q[[0, -1]], places[[0, 0]], atol=1e-6)
    assert spec.duration - spec.periods * plan.period >= edge - 1e-9
    assert spec.duration <= search.seconds
    again = make_reference(search.robot, spec, 250.0)  # checked against all limits
    np.testing.assert_allclose(again.q, plan.curve(again.t)[0])


def test_twins_are_told_as_such():
    robot, question = asked("coulomb_asymmetry", 4)
    found = with_twins(Search(question, robot, 12.0))
    same, _ = apart_by_no_motion(question, found.twins)
    assert [{a.name, b.name} for a, b in same] == [{"offset", "coulomb_asymmetry"}]
    assert promised(question) is None  # and nothing else is open


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[:-1], "expected 9 rows of 6 numbers, got 8 rows of 6"),
        (lambda rows: [row[:5] for row in rows], "got 9 rows of 5"),
        (lambda rows: [[np.inf] * 6, *rows[1:]], "expected finite numbers"),
        (lambda rows: [[9.0] * 6, *rows[1:]], "breaks its range limit"),
    ],
)
def test_coefficients_that_are_no_motion_are_refused(search, change, message):
    rows = [list(r) for r in written(drawn(search, 1)[0][1])]
    rows = tuple(tuple(r) for r in change(rows))
    with pytest.raises(Exception, match=message):
        make_reference(search.robot, TrajectorySpec(FOURIER, 12.0, 2, 0, rows), 100.0)
