"""The next motion: the soonest of all that were ranked, and the program of it."""

import json
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from flows.steps.next import rank_motions
from residual.planning.next_experiment import SURE
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import load_robot
from sim.engine.geometry import MARGIN, compute_clearances
from sim.engine.geometry import build_arm_capsules as arm_capsules
from sim.engine.plant_records import TrajectorySpec
from sim.trajectories import plan_reference_motion as plan_motion
from sim.trajectories.excitation import draw_feasible_series, export_series_coefficients
from sim.trajectories.planning_limits import build_workspace
from tests.flows.adopted_arm import unchecked
from tests.residual.planning.questions import logs, robot_and_question
from tests.synthetic.logs import write_csv


@pytest.fixture(scope="module")
def robot_and_ranking():
    robot, question = robot_and_question("spring", 2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("flows.steps.next.WAVES", 2)
        patch.setattr("flows.steps.next.PLACES", 2)
        return robot, rank_motions(question, robot, 12.0, seed=3)


def test_the_best_settles_the_question_and_none_of_the_others_sooner(robot_and_ranking):
    _, ranking = robot_and_ranking
    best, *others = ranking.ranked
    assert 1.0 < best.after <= 12.0
    assert SURE <= best.prospect.chance <= 1
    assert all(best.after <= (one.after or np.inf) for one in others)
    rivals = ranking.document(None)["rivals"]
    assert {r["name"] for r in rivals} == {"spring", "balancer"}


def test_it_keeps_all_limits_over_the_whole_motion(robot_and_ranking):
    """At 2 kHz, which is finer than the checks that it was planned with."""
    robot, ranking = robot_and_ranking
    motion = plan_motion(robot, ranking.best.spec, 2000.0)
    assert motion.t[-1] == 12.0
    assert (motion.q >= robot.lower).all()
    assert (motion.q <= robot.upper).all()
    assert (np.abs(motion.qd) <= robot.velocity_limit).all()
    torque = compute_inverse_dynamics(robot.model, motion.q, motion.qd, motion.qdd)
    assert (np.abs(torque) <= robot.torque_limit).all()
    assert compute_clearances(arm_capsules(robot.model), motion.q[::10]).min() >= MARGIN


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[:-1], "expected 9 rows of 6 numbers, got 8 rows of 6"),
        (lambda rows: [row[:5] for row in rows], "got 9 rows of 5"),
        (lambda rows: [[np.inf] * 6, *rows[1:]], "expected finite numbers"),
        (lambda rows: [[9.0] * 6, *rows[1:]], "breaks its range limit"),
    ],
)
def test_coefficients_that_are_no_motion_are_refused(change, message):
    robot = load_robot("irb140")
    series = draw_feasible_series(build_workspace(robot, 6.0), np.random.default_rng(3))
    rows = tuple(tuple(r) for r in change([list(r) for r in export_series_coefficients(series)]))
    with pytest.raises(Exception, match=message):
        plan_motion(robot, TrajectorySpec("fourier", 12.0, 2, 0, rows), 100.0)


# modelgap next: from a verdict and its logs to a program.


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("next")
    _, (fit, proof) = logs("spring", 2)
    for name, log in (("fit", fit), ("proof", proof)):
        write_csv(folder / f"{name}.csv", log)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        words = ["diagnose", "fit.csv", "--robot", "irb140", "--holdout", "proof.csv"]
        with unchecked():
            assert main([*words, "--json", "v.json", "--report", "v.html"]) == 0
    return folder


@pytest.fixture
def here(place, monkeypatch):
    monkeypatch.chdir(place)
    monkeypatch.setattr("flows.steps.next.WAVES", 2)
    with unchecked():
        yield place


GIVEN = ("v.json", "fit.csv", "--robot", "irb140", "--holdout", "proof.csv")


def test_a_verdict_says_by_itself_what_a_motion_could_settle(place):
    plan = json.loads((place / "v.json").read_text())["next_experiment"]
    assert {r["name"] for r in plan["rivals"]} == {"spring", "balancer"}
    assert [plan[k] for k in ("family", "parameters", "program")] == [None] * 3
    assert plan["seconds"] == 20.0
    assert (plan["expected_nats"] >= 6) == (plan["chance"] >= 0.5)
    assert plan["sure_after"] is None  # that is asked of a designed motion
    page = (place / "v.html").read_text()
    assert "Next experiment" in page
    assert "modelgap next designs it for this arm" in page


def test_a_program_is_found_written_and_explained(here, capsys):
    files = ("--out", "p.csv", "--json", "n.json")
    assert main(["next", *GIVEN, "--seconds", "8", *files]) == 0
    shown = capsys.readouterr().out
    assert "Next experiment: " in shown
    assert "The question is settled " in shown
    assert "settled after" in shown
    assert "wrote p.csv" in shown
    table = np.genfromtxt("p.csv", delimiter=",", names=True)
    assert len(table) == pytest.approx(250 * table["t"][-1] + 1)
    assert table["t"][-1] <= 8.0
    assert [n for n in table.dtype.names if n[0] == "t"] == ["t"]
    document = json.loads(Path("n.json").read_text())
    plan = document["next_experiment"]
    assert plan["program"] == "p.csv"
    assert document["effects"] == json.loads(Path("v.json").read_text())["effects"]
    assert plan["sure_after"] is not None
    assert f"{plan['sure_after']:.1f} s" in shown
    assert plan["seconds"] == table["t"][-1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["no.json"], "no such verdict"),
        (["fit.csv"], "is no JSON"),
        (["v.json"], "has the verdict but not the logs"),
        (["v.json", "fit.csv"], "has the verdict but not the logs"),
        ([*GIVEN, "--seconds", "1"], "--seconds 1: expected 4 to 600"),
        ([*GIVEN, "--rate", "0"], "--rate 0: expected 1"),
        ([*GIVEN, "--out", "v.json"], "would overwrite an input"),
        (["abc", "--store", "nowhere"], "nowhere"),
        (["abc", "fit.csv", "--robot", "irb140"], "has its own"),
    ],
)
def test_what_cannot_be_done_is_told_in_two_lines(here, capsys, words, message):
    assert main(["next", *words]) == 2
    complaint = capsys.readouterr().err
    assert message in complaint
    assert len(complaint.strip().splitlines()) <= 3


# modelgap trajectory: from the words to the files.


def run(*words):
    return main(["trajectory", *words])


def test_a_motion_is_described_and_its_csv_is_what_a_controller_reads(own_folder, capsys):
    assert run("welding", "--out", "w.csv", "--rate", "100", "--seed", "3") == 0
    shown = capsys.readouterr().out
    assert "welding motion of irb140: 20 s at 100 Hz" in shown
    assert "condition number" in shown
    assert "Share of the limits" in shown
    assert "wrote w.csv" in shown
    header, *lines = (own_folder / "w.csv").read_text().splitlines()
    names = [f"{name}{j}" for name in ("q", "qd", "qdd") for j in range(1, 7)]
    assert header.split(",") == ["t", *names]
    assert not any("-0.000000000," in line for line in lines)
    table = np.array([line.split(",") for line in lines], dtype=float)
    assert table.shape == (2001, 19)
    np.testing.assert_allclose(table[:, 0], np.arange(2001) / 100, atol=1e-9)
    middle = (table[2:, 1:7] - table[:-2, 1:7]) * 50
    np.testing.assert_allclose(middle, table[1:-1, 7:13], atol=0.05)
