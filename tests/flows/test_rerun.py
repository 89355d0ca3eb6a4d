"""A record made again: the same bits, or which value, from when, and why."""

import json
import shutil
from dataclasses import asdict, replace

import pyarrow.parquet as pq
import pytest

from flows.cli import main
from flows.requests import Diagnose
from flows.specs import parse_spec
from flows.steps import experiment, rerun
from flows.steps.diagnose import diagnose_stored_runs
from flows.steps.rerun import diff_records, find_cause
from residual.errors import InputError
from tests.verdict_documents import typed
from tests.warehouse import store_samples
from warehouse import code_provenance
from warehouse.queries import open_store
from warehouse.record_commit import commit_run
from warehouse.store_catalogue import RERUN_OF, find_record, open_seal, read_manifest, read_record
from warehouse.store_catalogue import list_record_folders as record_folders
from warehouse.store_files import write_check_sums, write_parquet

NO_ID = [["rerun", "--verify"], ["diff", "a"], ["lineage"]]

EFFECTS = [
    {"name": "payload", "joints": [6], "mass": 4, "com_x": 1 / 3, "onset": 0.5},
    {"name": "coupled_friction", "joints": [5, 6], "level": 1.0},
]


def spec(**changes):
    content = {
        "seed": 7,
        "start": 30.0,
        "trajectory": {"kind": "welding", "duration": 2.0},
        "plant": {"effect": EFFECTS, "salt": "ü"},
    }
    return parse_spec(content | changes, "SPEC.toml")


@pytest.fixture
def other_code(monkeypatch):
    """Let the code be another one, from now on."""

    def change():
        known = code_provenance.read_code_provenance()
        changed_code = replace(known, code_hash="f" * 64, program_hash="e" * 64)
        for place in ("warehouse.code_provenance", "flows.steps.experiment"):
            hash = f"{place}.hash_plant_code"
            monkeypatch.setattr(hash, lambda: changed_code.code_hash)
        for place in ("flows.steps.rerun", "warehouse.record_commit"):
            monkeypatch.setattr(f"{place}.read_code_provenance", lambda: changed_code)

    return change


def tree(folder):
    files = (p for p in folder.rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


def change_value(store, id, by=1e-9):
    path = find_record(store, id).folder / "part-0.parquet"
    table = pq.ParquetFile(path).read()
    values = table.column("tau3").to_numpy().copy()
    values[30] += by
    at = table.column_names.index("tau3")
    write_parquet(path, table.set_column(at, table.schema.field(at), [values]))
    write_check_sums(path.parent)


def test_a_spec_comes_back_from_its_two_halves(tmp_path, plant):
    for wanted in (spec(), spec(seed=2**62, plant={}), spec(rates={"log": 500.0})):
        id = experiment.simulate_and_store(wanted, tmp_path)
        told, hidden = read_manifest(tmp_path, id), open_seal(tmp_path, id).spec
        again = rerun.rebuild_spec(told, hidden)
        assert experiment.compute_run_id(again) == id
        assert again.plant_spec() == wanted.plant_spec()


@pytest.mark.parametrize("words", [["--verify"], []])
def test_the_same_code_gives_the_same_bits_stores_nothing(tmp_path, plant, capsys, words):
    id = experiment.simulate_and_store(spec(), tmp_path)
    before = tree(tmp_path)
    assert main(["rerun", id[:8], *words, "--store", str(tmp_path)]) == 0
    assert "identical bit for bit" in capsys.readouterr().out
    assert tree(tmp_path) == before


def test_other_code_with_other_values_is_a_new_run_and_is_told(tmp_path, plant, other_code, capsys):
    id = experiment.simulate_and_store(spec(), tmp_path)
    other_code()
    plant["tau"] = 2.5
    before = tree(tmp_path)
    outcome = rerun.rerun(id, tmp_path, verify=True)
    assert tree(tmp_path) == before
    (bad,) = outcome.differences
    assert (bad.name, bad.unit, bad.largest) == ("tau3", "N m", pytest.approx(2.5))
    assert bad.first == pytest.approx(30.08)
    assert (outcome.cause.kind, outcome.same_code) == ("code", False)
    assert main(["rerun", id, "--verify", "--store", str(tmp_path)]) == 1
    # Without --verify the new run is what was asked for.
    assert main(["rerun", id, "--store", str(tmp_path)]) == 0
    capsys.readouterr()
    (new,) = set(record_folders(tmp_path, "runs")) - {id}
    assert read_manifest(tmp_path, new)["parents"] == {RERUN_OF: [id]}
    with open_store(tmp_path) as store:
        rows = store.sql("FROM lineage").to_pylist()
    assert {"child": new, "parent": id, "role": RERUN_OF} in rows
    named = ["sql", "--named", "reruns_not_reproduced", "--format", "json"]
    assert main([*named, "--store", str(tmp_path)]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["record"], row["rerun"]) == (id, new)
    assert "tau3: differs from 30.08 s on, by at most 2.5 N m" in row["verdict"]


def test_other_code_with_the_same_values_is_no_failure(tmp_path, plant, other_code):
    id = experiment.simulate_and_store(spec(), tmp_path)
    other_code()
    outcome = rerun.rerun(id, tmp_path)
    assert outcome.reproduced
    assert (outcome.same_code, outcome.note_id) == (False, None)
    assert outcome.new_id != id


def test_the_same_code_with_other_values_is_chance(tmp_path, plant, capsys):
    id = experiment.simulate_and_store(spec(), tmp_path)
    plant["tau"] = 1e-15
    assert main(["rerun", id, "--store", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    assert "nondeterminism" in out
    assert "tau3: differs from 30.08 s on" in out
    assert list(record_folders(tmp_path, "runs")) == [id]
    assert len(record_folders(tmp_path, "validations")) == 1


def test_a_value_that_was_tampered_with_is_found(tmp_path, plant):
    id = experiment.simulate_and_store(spec(), tmp_path)
    change_value(tmp_path, id)
    outcome = rerun.rerun(id, tmp_path, verify=True)
    (bad,) = outcome.differences
    assert (bad.name, bad.differing, outcome.cause.kind) == ("tau3", 1, "damaged")
    assert bad.largest == pytest.approx(1e-9, rel=1e-5)
    assert bad.first == pytest.approx(30.12)


def test_libraries_and_machine_are_causes_by_name(tmp_path):
    now = asdict(code_provenance.read_code_provenance())
    then = {**now, "environment_hash": "0" * 64}
    then["versions"] = {**now["versions"], "numpy": "1.0"}
    cause = find_cause(then, now, "code_hash", (), tmp_path)
    assert cause.kind == "environment"
    assert f"numpy 1.0 -> {now['versions']['numpy']}" in cause.why
    packages = code_provenance.list_installed_packages()
    import hashlib

    lines = packages + b"\nzzz==1.0"
    then["environment_hash"] = hashlib.sha256(lines).hexdigest()
    then["versions"] = now["versions"]
    (tmp_path / "made_with").mkdir()
    for name, content in ((then, lines), (now, packages)):
        path = tmp_path / "made_with" / f"packages-{name['environment_hash']}.txt"
        path.write_bytes(content)
    cause = find_cause(then, now, "code_hash", (), tmp_path)
    assert cause.why == "zzz 1.0 -> none"
    then = {**now, "machine": "another one"}
    assert find_cause(then, now, "code_hash", (), tmp_path).kind == "machine"


def test_a_measured_run_is_checked_and_not_made_again(tmp_path, capsys):
    id = commit_run(tmp_path, store_samples.recording(), {"robot_hash": "a" * 64})
    words = ["rerun", id, "--store", str(tmp_path)]
    assert main(words) == 2
    assert "measured, not simulated" in capsys.readouterr().err
    assert main([*words, "--verify"]) == 0
    assert "match the import" in capsys.readouterr().out
    path = find_record(tmp_path, id).folder / "part-0.parquet"
    table = pq.ParquetFile(path).read()
    at = table.column_names.index("q1")
    values = table.column("q1").to_numpy() + 1
    write_parquet(path, table.set_column(at, table.schema.field(at), [values]))
    assert main([*words, "--verify"]) == 1


def test_without_its_seal_a_run_cannot_be_made_again(tmp_path, plant):
    id = experiment.simulate_and_store(spec(), tmp_path)
    shutil.rmtree(tmp_path / "sealed")
    with pytest.raises(InputError, match="no sealed half"):
        rerun.rerun(id, tmp_path, verify=True)


def test_the_robot_of_a_run_is_kept_and_travels_with_it(tmp_path, plant, monkeypatch):
    from residual.robot.robot import load_robot

    arm = tmp_path / "arm"
    arm.mkdir()
    (arm / "x.urdf").write_text(load_robot("irb140").urdf)
    (arm / "robot.toml").write_text('[robot]\nname = "mine"\n')
    id = experiment.simulate_and_store(spec(robot=str(arm)), tmp_path / "here")
    shutil.rmtree(arm)
    experiment._robot.cache_clear()
    there = tmp_path / "there"
    shutil.copytree(tmp_path / "here", there)
    assert rerun.rerun(id, there, verify=True).reproduced
    shutil.rmtree(there / "robots")
    with pytest.raises(InputError, match="robot that this was made with is missing"):
        rerun.rerun(id, there, verify=True)


@pytest.fixture
def diagnosed(tmp_path, plant, calls, monkeypatch):
    from residual.verdict.result import Diagnosis

    def diagnose(robot, fit, **options):
        doc = store_samples.verdict([log.id for log in options["held_out"]])
        doc["robot"] = robot.name
        doc["nominal_scale"] = float(sum(log.tau.sum() for log in fit)) + plant["tau"]
        return Diagnosis(typed(doc, 2))

    monkeypatch.setattr("residual.diagnosis.diagnose.diagnose", diagnose)
    monkeypatch.setattr("flows.storage.build_run_error_rows", lambda _: [])
    runs = [experiment.simulate_and_store(spec(seed=k), tmp_path) for k in range(3)]
    fit, held_out = tuple(runs[:2]), (runs[2],)
    request = Diagnose(fit, robot="irb140", held_out=held_out, store=tmp_path)
    return tmp_path, runs, diagnose_stored_runs(request)


def test_a_diagnosis_its_model_and_its_proof_are_made_again(diagnosed):
    store, _runs, (diagnosis, proof) = diagnosed
    before = tree(store)
    model = read_record(store, diagnosis)["model_id"]
    for id in (diagnosis, proof, model):
        outcome = rerun.rerun(id, store)
        assert outcome.reproduced
        assert (outcome.same_code, outcome.new_id) == (True, None)
    assert tree(store) == before


def test_a_diagnosis_with_a_known_value_is_of_the_same_robot(diagnosed):
    store, runs, _ = diagnosed
    known = ("payload.mass=2",)
    request = Diagnose(tuple(runs), robot="irb140", known=known, store=store)
    diagnosis, _proof = diagnose_stored_runs(request)
    assert rerun.rerun(diagnosis, store, verify=True).reproduced


def test_a_diagnosis_that_differs_is_told_and_kept(diagnosed, plant, other_code):
    store, _runs, (diagnosis, _proof) = diagnosed
    plant["tau"] = 0.5
    told = rerun.rerun(diagnosis, store, verify=True)
    assert (told.cause.kind, told.new_id) == ("nondeterminism", None)
    names = {c.name for c in told.differences}
    assert names == {"nominal_scale", "document.nominal_scale"}
    assert told.differences[0].largest == pytest.approx(0.5)
    other_code()
    told = rerun.rerun(diagnosis, store)
    assert told.cause.kind == "code"
    record = read_record(store, told.new_id)
    before = read_record(store, diagnosis)["nominal_scale"]
    assert record["document"]["nominal_scale"] != before
    with open_store(store) as opened:
        query = f"SELECT parent, role FROM lineage WHERE child = '{told.new_id}'"
        rows = opened.sql(query).to_pylist()
    assert {"parent": diagnosis, "role": RERUN_OF} in rows
    assert {"parent": record["model_id"], "role": "model"} in rows
    difference = diff_records(diagnosis, told.new_id, store)
    assert not difference.same
    assert "nominal_scale" in {name for name, _, _ in difference.tables["values"]}


def test_a_record_that_does_not_say_how_it_was_made_is_refused(tmp_path):
    from warehouse.record_commit import commit_record

    record = {"robot": "two_link", "kind": "other"}
    id = commit_record(tmp_path, "validations", record)
    with pytest.raises(InputError, match="has no record of its request"):
        rerun.rerun(id, tmp_path)
    report = commit_record(tmp_path, "reports", record)
    with pytest.raises(InputError, match="is a report"):
        rerun.rerun(report, tmp_path)


def test_two_runs_side_by_side(tmp_path, plant, capsys):
    one = experiment.simulate_and_store(spec(), tmp_path)
    two = experiment.simulate_and_store(spec(start=0.0), tmp_path)
    store = ["--store", str(tmp_path)]
    assert main(["diff", one, two, "--format", "json", *store]) == 0
    doc = json.loads(capsys.readouterr().out)
    assert {"name": "start", "one": 30.0, "two": 0.0} in doc["spec"]
    assert doc["code"] == doc["environment"] == []
    equal = {c["name"]: c["equal"] for c in doc["data"]}
    assert equal["tau1"]
    assert not equal["t"]
    assert doc["same"] is False
    assert main(["diff", one, two, *store]) == 0
    assert "code: identical" in capsys.readouterr().out
    assert main(["lineage", one, *store]) == 0
    assert f"runs {one}, gave" in capsys.readouterr().out


@pytest.mark.parametrize("words", NO_ID)
def test_what_is_no_id_is_refused(tmp_path, capsys, words):
    command, *more = words
    assert main([command, "../x", *more, "--store", str(tmp_path)]) == 2
    assert "is not an id" in capsys.readouterr().err
