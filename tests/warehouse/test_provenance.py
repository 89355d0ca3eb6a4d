"""What records were made from, and stores that an older program wrote."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from flows.cli import main
from flows.steps import check as checking
from flows.steps.rerun import rerun
from residual.diagnosis import diagnose as diagnosis
from tests.once import once
from tests.warehouse import store_samples as samples
from warehouse import code_provenance
from warehouse.code_provenance import ROOT, hash_plant_code, list_plant_files
from warehouse.code_provenance import format_uncommitted_change as uncommitted_change
from warehouse.queries import open_store
from warehouse.sql_guard import NAMED, TAKES
from warehouse.store_catalogue import list_record_folders, read_manifest, read_record

# Which code made a record: its hash, its uncommitted changes, its commit.


FILES = {
    "sim/__init__.py": "",
    "sim/plant.py": "from residual.dynamics import regressor\n",
    "sim/experiment.py": "def run():\n    from residual import robot\n",
    "sim/arm.urdf": "<robot/>",
    "sim/__pycache__/plant.pyc": "x",
    "residual/__init__.py": "",
    "residual/dynamics.py": "import numpy\nfrom residual.recording import Recording\n",
    "residual/recording.py": "from . import errors\n",
    "residual/errors.py": "",
    "residual/robot.py": "import residual.deep.inner as inner\n",
    "residual/deep/__init__.py": "",
    "residual/deep/inner.py": "",
    "residual/effects.py": "from residual.recording import Recording\n",
    "flows/steps.py": "from residual import effects\n",
}
UNCOUNTED = {"sim/__pycache__/plant.pyc", "residual/effects.py", "flows/steps.py"}
COUNTED = set(FILES) - UNCOUNTED


@pytest.fixture
def tree(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def code_hash(tree):
    return hash_plant_code.__wrapped__(tree)  # past the cache


def test_only_the_code_of_the_plant_changes_the_hash(tree):
    assert {p.relative_to(tree).as_posix() for p in list_plant_files(tree)} == COUNTED
    before = code_hash(tree)
    for name in FILES:
        (tree / name).write_text(FILES[name] + "\n# another line\n")
        assert (code_hash(tree) != before) == (name in COUNTED)
        (tree / name).write_text(FILES[name])
    assert code_hash(tree) == before


def test_the_hash_of_a_tree_is_that_of_the_first_version(tree):
    # The ids of all runs hang on it: as ab4d41df computed it.
    hash = "f2fd29d0946fe1f9ba64f4c030608b8e02d5eb2d39697e7cc9d083c4d4396e4f"
    assert code_hash(tree) == hash


def test_beside_its_libraries_a_program_has_the_hashes_of_its_checkout(tree):
    program_hash = code_provenance.hash_program_code.__wrapped__
    before = (code_hash(tree), program_hash(tree))
    beside = {
        "numpy/__init__.py": "from numpy import broken\nimport residual.effects\n",
        "numpy/broken.py": "import nothing.of.the.kind\nthis is no Python\n",
        "warehouse/commit.txt": "0123",
        "flows/shared/prefect.yaml": "name: modelgap",
        "flows/__pycache__/steps.pyc": "x",
    }
    for name, text in beside.items():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / name).write_text(text)
    assert (code_hash(tree), program_hash(tree)) == before
    (tree / "flows" / "steps.py").write_text("")
    assert program_hash(tree) != before[1]


def test_the_diagnosis_is_no_part_of_our_plant():
    names = {p.relative_to(ROOT).as_posix() for p in list_plant_files()}
    assert {"sim/__init__.py", "residual/__init__.py"} <= names
    ours = ("residual/effects", "residual/evidence", "residual/diagnosis", "flows")
    assert not {n for n in names if n.startswith(ours)}


def test_code_and_environment_are_named():
    known = code_provenance.read_code_provenance()
    assert known.code_hash == hash_plant_code()
    in_git = (ROOT / ".git").exists()  # not where an archive was unpacked
    assert len(known.commit or "") == (40 if in_git else 0)
    assert (known.dirty is None) == (not in_git)


GIT = ("git", "-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")


def git(root, *words):
    return subprocess.run(
        [*GIT, "-C", str(root), *words], check=True, capture_output=True, text=True
    ).stdout


def captured(root):
    return code_provenance.describe_uncommitted_files.__wrapped__(root)  # past the cache


@pytest.fixture
def root(tmp_path):
    place = tmp_path / "checkout"
    for name in ("warehouse/__init__.py", "sim/plant.py"):
        (place / name).parent.mkdir(parents=True)
        (place / name).write_text("a = 1\nb = 2\n")
    git(tmp_path, "init", "-q", str(place))
    git(place, "add", "-A")
    git(place, "commit", "-q", "-m", "first")
    return place


def test_uncommitted_changes_are_named_and_hashed(root, tmp_path):
    (root / "notes.txt").write_text("not code")
    assert captured(root) == {"sha256": None, "count": 0, "files": []}
    assert "none" in uncommitted_change({"uncommitted": captured(root)})
    hashes = set()
    for name, text in (("sim/plant.py", "a = 3\n"), ("sim/new.py", "a"), ("sim/new.py", "b")):
        (root / name).write_text(text)
        uncommitted = captured(root)
        hashes.add(uncommitted["sha256"])
    assert len(hashes) == 3
    assert uncommitted["count"] == 2
    assert uncommitted["files"] == ["sim/plant.py", "sim/new.py"]
    assert "sim/plant.py, sim/new.py, on" in uncommitted_change({"uncommitted": uncommitted})
    assert captured(tmp_path) is None
    assert "unknown" in uncommitted_change({"uncommitted": None})


def test_the_packages_of_a_record_are_kept_once(tmp_path):
    ids = [samples.commit(tmp_path, seed) for seed in range(2)]
    (kept,) = (tmp_path / "made_with").iterdir()
    known = read_manifest(tmp_path, ids[0])["provenance"]
    assert code_provenance.read_package_versions(tmp_path, known)["numpy"]
    kept.write_bytes(kept.read_bytes()[1:])
    assert code_provenance.read_package_versions(tmp_path, known) is None


def test_a_checkout_says_the_commit_of_git(capsys):
    assert main(["--version"]) == 0
    shown = capsys.readouterr().out.strip()
    head = git(ROOT, "rev-parse", "HEAD").strip()
    assert re.fullmatch(rf"\S+ \(commit {head[:12]}\)", shown)


# A store that commit ab4d41df wrote: it opens, verifies, reruns, answers.


# Where linear algebra takes another path, on another machine, the last digits differ.
ROUNDING = 1e-9
ASKED = {"effect": "payload", "name": "coulomb", "date": "2026-12-31", "days": "0"}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    store = tmp_path_factory.mktemp("old") / "store"
    shutil.copytree(Path(__file__).parent / "ab4d41df" / "store", store)
    return store


def test_it_opens_and_verifies(store, capsys):
    assert main(["store", "verify", "--store", str(store)]) == 0
    assert "3 runs, 3 models, 1 diagnoses, 3 validations" in capsys.readouterr().out


@pytest.fixture(scope="module")
def opened(store):
    with open_store(store) as opened:
        yield opened


@pytest.mark.parametrize("query", sorted(NAMED))
def test_every_named_query_answers(opened, query):
    (run,) = opened.sql("SELECT min(run_id) FROM runs")["min(run_id)"].to_pylist()
    (model,) = opened.sql("SELECT model_id FROM diagnoses")["model_id"].to_pylist()
    known = {"run": run, "model": model, **ASKED}
    values = {key: known[key] for key in TAKES.get(query, ())}
    assert opened.sql(NAMED[query][1], values).column_names


@pytest.fixture(scope="module")
def diagnosed_once():
    """A diagnosis and the model that it ended with ask the method the same."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name in ((checking, "check_logs"), (diagnosis, "diagnose")):
            patch.setattr(module, name, once(getattr(module, name)))
        yield


@pytest.mark.slow
@pytest.mark.usefixtures("diagnosed_once")
@pytest.mark.parametrize("kind", ["runs", "models", "diagnoses"])
def test_its_records_are_made_again(store, kind):
    ids = list_record_folders(store, kind)
    if kind == "runs":  # one of the two that were simulated: planning takes seconds
        ids = [id for id in ids if "spec" in read_manifest(store, id)][:1]
    if kind == "models":  # not the tables: tests/flows make such a record again
        ids = [id for id in ids if read_record(store, id).get("stage") != "calibrated"]
        assert len(ids) == 2
    for id in ids:
        again = rerun(id, store)
        # A run is the same for ever; what the method says of it moves with the method.
        differences = again.differences if kind == "runs" else ()
        assert all(abs(c.largest) < ROUNDING for c in differences), id
        # Other code stores a run anew, beside the one that it was made from; other
        # records where they are not the same, whose id they would have.
        stored = again.new_id is not None
        assert stored != again.same_code or (kind != "runs" and not again.differences)
    assert main(["store", "verify", "--store", str(store)]) == 0
