"""The motion that is found: better than where it began, and within all limits."""

import numpy as np
import pytest

from flows.steps.planning.design import (
    RANDOM,
    apart_by_no_motion,
    design,
    document,
    improve,
)
from flows.steps.planning.motions import (
    FOURIER,
    Search,
    drawn,
    fourier,
    planned,
    seconds_to,
    series_gram,
    with_twins,
)
from residual.planning.promise import promised
from residual.robot.dynamics import inverse_dynamics
from sim.engine.geometry import MARGIN, body, clearances
from sim.engine.records import TrajectorySpec
from sim.trajectories import make_reference
from sim.trajectories.fourier import draw, given, written
from sim.trajectories.limits import workspace
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
    before, after = (
        search.weighed(series_gram(search, place, s)).worth for s in (start, found)
    )
    assert after > 1.2 * before


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


def test_a_motion_is_the_same_when_it_is_written_down(search):
    place = workspace(search.robot, 6.0)
    series = draw(place, np.random.default_rng(0))
    again = given(written(series), search.robot.dof, 6.0)
    for name in ("centre", "sine", "cosine"):
        np.testing.assert_allclose(
            getattr(again, name), getattr(series, name), atol=1e-8
        )


def test_a_design_is_compared_with_what_was_not_designed(search, monkeypatch):
    monkeypatch.setattr("flows.steps.planning.design.MANY", 6)
    monkeypatch.setattr("flows.steps.planning.design._LOOKS", 70)
    made = design(search)
    names = [c.name for c in made.compared]
    assert names[0] == RANDOM
    assert {"cyclic", "welding", "move_stop_move"} & set(names)
    usual = {c.name: c.nats for c in made.compared}
    assert made.best.seen.least > usual[RANDOM]
    assert 0 <= made.chance <= 1
    plan = document(made, "p.csv")
    assert set(plan) == {
        "rivals",
        "family",
        "parameters",
        "seconds",
        "expected_nats",
        "chance",
        "program",
    }
    assert {r["name"] for r in plan["rivals"]} == {"spring", "balancer"}
    spec = TrajectorySpec.from_record(
        {"kind": plan["family"], "duration": plan["seconds"], **plan["parameters"]}
    )
    again = make_reference(search.robot, spec, 100.0)
    first = make_reference(search.robot, made.best.spec, 100.0)
    np.testing.assert_array_equal(again.q, first.q)


def test_a_motion_has_enough_no_sooner_than_half_of_it(search, better):
    place, _, found = better
    motion = fourier(search, place, found)
    end = seconds_to(search, motion)
    assert end is None or 0 < end <= 12.0
    short = planned(search, TrajectorySpec("move_stop_move", 12.0, 2, 1))
    assert short is not None
    assert short.seen.worth < motion.seen.worth


def test_a_family_without_room_is_left_out(search):
    assert planned(search, TrajectorySpec("cyclic", 3.0, 2, 1)) is None


def test_twins_are_told_as_such():
    robot, question = asked("coulomb_asymmetry", 4)
    found = with_twins(Search(question, robot, 12.0))
    same, _ = apart_by_no_motion(question, found.twins)
    assert [{a.name, b.name} for a, b in same] == [{"offset", "coulomb_asymmetry"}]
    told = promised(question)
    assert told is not None
    assert "balancer" in {p.name for p in told.rivals}


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
    rows = [list(r) for r in drawn_rows(search)]
    rows = tuple(tuple(r) for r in change(rows))
    with pytest.raises(Exception, match=message):
        make_reference(search.robot, TrajectorySpec(FOURIER, 12.0, 2, 0, rows), 100.0)


def drawn_rows(search):
    _, series = drawn(search, 1)[0]
    return written(series)
