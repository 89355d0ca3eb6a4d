"""A designed motion on the arm of stored runs: the same arm, later in its session."""

import numpy as np
import pytest

from flows.cli import main
from flows.inputs.given import load
from flows.requests import Diagnose
from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment, rerun
from flows.steps.diagnose import diagnose_runs, request_of
from flows.steps.planning.ask import Next, ask
from flows.steps.planning.execute import execute, next_spec
from residual.errors import InputError
from residual.recording import Recording
from sim.engine.records import TrajectorySpec
from sim.trajectories.fourier import draw, written
from sim.trajectories.limits import workspace
from warehouse.commit import commit_run
from warehouse.layout import read_record
from warehouse.runs import open_seal, read_manifest, read_run

SPRING = {"name": "spring", "joints": [3], "stiffness": 6.0, "rest": -0.4}


def spec(number, kind):
    return ExperimentSpec.model_validate(
        {
            "seed": 5,
            "start": 30.0 * number,
            "trajectory": {"kind": kind, "duration": 6.0, "periods": 1, "seed": number},
            "plant": {"seed": 11, "effect": [SPRING]},
        }
    )


def motion(seconds=6.0):
    place = workspace(load("irb140"), seconds)
    series = draw(place, np.random.default_rng(4))
    return TrajectorySpec("fourier", seconds, 1, 0, written(series))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A store with two runs of an arm, and the request to diagnose them."""
    store = tmp_path_factory.mktemp("store")
    kinds = ("move_stop_move", "move_stop_move")
    ids = [experiment.run(spec(i, kind), store) for i, kind in enumerate(kinds)]
    return store, request_of({"fit": ids[:1], "held_out": ids[1:]}, store)


@pytest.fixture(scope="module")
def known(made):
    """Ids of the diagnosis of these runs and of its proof."""
    return diagnose_runs(made[1])


@pytest.fixture(scope="module")
def done(made):
    """The same with the run of a motion that is given by its numbers."""
    store, request = made
    return store, request, execute(request, motion())


def test_it_is_the_same_arm_later_in_its_session(done):
    store, request, id = done
    first, new = (open_seal(store, i).spec for i in (request.logs[0], id))
    assert new == first
    manifest = read_manifest(store, id)
    assert manifest["spec"]["start"] == 30.0 + 6.0 + 10.0
    told = manifest["spec"]["trajectory"]
    assert np.shape(told["coefficients"]) == (9, 6)
    log = read_run(store, id)
    assert log.t[0] == pytest.approx(46.0, abs=0.01)


def test_its_run_is_made_again_bit_for_bit(done):
    store, _, id = done
    assert rerun.rerun(id, store, verify=True).reproduced


def test_an_id_is_enough_to_ask_and_the_verdict_is_the_same_again(made, known):
    store, request = made
    asked = ask(Next(known[1][:8], seconds=8.0, store=store))
    assert asked.same
    assert asked.request.logs == request.logs
    with pytest.raises(InputError, match="one of runs, expected a diagnosis"):
        ask(Next(request.logs[0], store=store))


@pytest.mark.long
def test_one_command_designs_runs_and_diagnoses(made, known, capsys):
    (store, request), (diagnosis, _) = made, known
    words = ["--seconds", "6", "--run", "--store", str(store)]
    assert main(["next", diagnosis, *words]) == 0
    told = capsys.readouterr().out
    assert "ran it on the simulated arm: run" in told
    new = told.rsplit("modelgap show ", 1)[1].strip()
    record = read_record(store, new)["request"]
    assert len(record["logs"]) == len(request.logs) + 1
    assert tuple(record["held_out"]) == request.held_out


def test_a_measured_log_cannot_be_run_on(made, tmp_path):
    t = np.arange(500) / 100
    q = 0.3 * np.sin(t[:, None] * np.arange(1, 7))
    log = Recording("m", "irb140", t, q, np.cos(q))
    about = {"source": "imported", "robot_hash": load("irb140").content_hash}
    id = commit_run(tmp_path, log, about)
    request = Diagnose(logs=(id,), robot="irb140", store=tmp_path)
    with pytest.raises(InputError, match="is a measured log"):
        next_spec(tmp_path, request, motion())
