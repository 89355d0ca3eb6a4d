"""modelgap monitor: from runs of the store to alarms, a record and a picture."""

import json
from dataclasses import replace

import numpy as np
import pytest

from flows.cli import main
from flows.inputs import load_run_robot
from flows.report.experiments import describe_alarms
from flows.requests import Monitor
from flows.specs import parse_spec
from flows.steps import experiment, monitor
from flows.storage import store_outcome
from residual.effects import load_effects
from residual.model.model import Model, Term
from residual.model.nominal import build_free_nominal, prepare_fit_logs
from residual.signals.track import FilterSettings
from residual.verdict.result import Diagnosis
from tests.verdict_documents import typed
from warehouse.queries import open_store
from warehouse.store_catalogue import read_record, read_run

ROBOT = "irb140"


def run(store, seed, *effects, start=0.0):
    content = {
        "start": start,
        "trajectory": {"kind": "cyclic", "duration": 4.0, "periods": 1, "seed": seed},
        "plant": {"seed": 1, "effect": list(effects)},
        "rates": {"control": 500, "log": 250},
    }
    return experiment.simulate_and_store(parse_spec(content, "SPEC.toml"), store)


@pytest.fixture(scope="module")
def run_store(tmp_path_factory, compiled_plant):
    store = tmp_path_factory.mktemp("store")
    good = [run(store, 1, start=s) for s in (0.0, 50.0, 100.0, 150.0)]
    jump = {"name": "encoder_offset", "joints": [3], "angle": 0.05, "onset": 2.0}
    return store, good[:3], good[3], run(store, 1, jump, start=200.0)


@pytest.fixture(scope="module")
def watched(run_store):
    store, good, fine, bad = run_store
    return monitor.monitor(Monitor(ROBOT, (fine, bad), tuple(good), store=store))


def test_the_jump_is_found_and_the_good_run_left_in_peace(run_store, watched):
    _, _, fine, bad = run_store
    _, report, runs = watched
    assert report.alarms[fine] == ()
    (first, *_) = report.alarms[bad]
    assert (first.joint, first.sensor, first.fault) == (3, "encoder", "jump")
    assert 0 <= first.time - runs[bad].t[0] - 2.0 < 0.1
    assert report.seconds == pytest.approx(8.0)
    assert "encoder of joint 3" in describe_alarms(report)
    assert "extrapolated" in report.notes[0]


def test_the_record_has_alarms_limits_and_lineage(run_store, watched):
    store, good, fine, bad = run_store
    id, report, _ = watched
    record = read_record(store, id)
    assert (record["robot"], record["kind"]) == (ROBOT, "monitor")
    assert record["alarms"] == {fine: 0, bad: len(report.alarms[bad])}
    assert record["monitor"] == json.loads(json.dumps(report.monitor.to_record()))
    with open_store(store) as opened:
        table = opened.sql(f"FROM alarms WHERE validation_id = '{id}'")
        assert table.num_rows == len(report.alarms[bad])
        assert (table["run_id"][0].as_py(), table["fault"][0].as_py()) == (bad, "jump")
        query = f"SELECT parent, role FROM lineage WHERE child = '{id}'"
        rows = {(r["parent"], r["role"]) for r in opened.sql(query).to_pylist()}
    roles = [("calibration", g) for g in good] + [("watched", r) for r in (fine, bad)]
    assert rows == {(run, role) for role, run in roles}


def test_a_diagnosis_brings_its_very_model_and_its_good_runs(run_store):
    store, good, fine, _ = run_store
    robot = load_run_robot(ROBOT, good, store)
    logs = prepare_fit_logs(robot, [read_run(store, id) for id in good], None, FilterSettings())
    nominal = build_free_nominal(logs, ("viscous", "coulomb", "rotor_inertia")).model
    known = load_effects()
    more = (
        Term(known["coulomb_asymmetry"], (1,), (), np.array([1.0])),
        Term(known["coulomb_asymmetry"], (2,), (), np.array([2.0])),
        Term(known["payload"], (5,), (), 0.5 * np.eye(10)[0]),
    )
    augmented = replace(nominal, terms=(*nominal.terms, *more))
    diagnosis = Diagnosis(
        typed({"robot": ROBOT, "effects": [{"name": "payload", "joints": [6]}]}),
        {"nominal": nominal, "augmented": augmented},
    )
    id, _ = store_outcome(store, diagnosis, {"fit": good}, serial=robot.serial)
    record_id, watched, _ = monitor.monitor(Monitor(id, (fine,), store=store))
    assert sorted(watched.calibration) == sorted(good)
    assert watched.monitor.model.to_record() == augmented.to_record()
    assert watched.alarms[fine] == ()
    record = read_record(store, record_id)
    assert record["model_id"]
    kept = Model.from_record(record["monitor"]["model"])
    assert kept.to_record() == augmented.to_record()


def test_the_command_prints_a_table(run_store, capsys):
    store, good, fine, bad = run_store
    words = ["monitor", ROBOT, bad[:8], "--calibrate", *good, "--store", str(store)]
    assert main(words) == 0
    output = capsys.readouterr().out
    for word in (bad[:8], "encoder", "jump", "1 run", "modelgap show"):
        assert word in output
    assert main([*words[:2], fine, *words[3:]]) == 0
    assert "No alarm in 4 s of 1 run" in capsys.readouterr().out


# G, GG and GGG stand for good runs, F for the one that is watched.
BAD = {
    "irb140 F": "there are none, expected at least 3",
    "irb140 F --calibrate GG": "2 runs to calibrate on, expected",
    "irb140 G --calibrate GGG": "both monitored and used to calib",
    "irb140 F F --calibrate GGG": "is given twice",
    "irb140 --calibrate GGG": "No run to monitor",
    "abc123 F --calibrate GGG": "is no diagnosis in",
    "irb14 F --calibrate GGG": "irb140",
    "irb140 zz --calibrate GGG": "'zz' is not an id",
    "irb140 F --calibrate GGG --per-hour 0": "0 false alarms per hour",
}


@pytest.mark.parametrize("words", BAD)
def test_what_cannot_be_watched_is_said_in_two_lines(run_store, capsys, words):
    store, good, fine, _ = run_store
    ids = {"F": [fine], **{"G" * n: good[:n] for n in (1, 2, 3)}}
    given = [each for word in words.split() for each in ids.get(word, [word])]
    assert main(["monitor", *given, "--store", str(store)]) == 2
    error = capsys.readouterr().err
    assert BAD[words] in error
    assert error.count("\n") <= 2
