"""The hash of the plant's code: what changes it and what does not."""

import pytest

from warehouse.provenance import ROOT, plant_code_hash, plant_files, provenance

FILES = {
    "sim/__init__.py": "",
    "sim/plant.py": "from residual.dynamics import regressor\n",
    "sim/twin.py": "def run():\n    from residual import robot\n",
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
COUNTED = set(FILES) - {
    "sim/__pycache__/plant.pyc",
    "residual/effects.py",
    "flows/steps.py",
}


@pytest.fixture
def root(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def code_hash(root):
    return plant_code_hash.__wrapped__(root)  # past the cache


def test_the_plant_is_sim_and_what_it_imports_of_the_core(root):
    assert {p.relative_to(root).as_posix() for p in plant_files(root)} == COUNTED


@pytest.mark.parametrize("name", FILES)
def test_only_the_code_of_the_plant_changes_the_hash(root, name):
    before = code_hash(root)
    assert code_hash(root) == before
    (root / name).write_text(FILES[name] + "\n# another line\n")
    assert (code_hash(root) != before) == (name in COUNTED)


def test_a_file_that_is_renamed_changes_the_hash(root):
    before = code_hash(root)
    (root / "sim" / "arm.urdf").rename(root / "sim" / "leg.urdf")
    assert code_hash(root) != before


def test_the_diagnosis_is_no_part_of_our_plant():
    names = {p.relative_to(ROOT).as_posix() for p in plant_files()}
    assert {"sim/__init__.py", "residual/__init__.py"} <= names
    assert not {n for n in names if n.startswith(("residual/effects", "flows"))}
    assert "residual/diagnosis/examine.py" not in names


def test_code_and_environment_are_named():
    known = provenance()
    assert known.code_hash == plant_code_hash()
    in_git = (ROOT / ".git").exists()  # not where an archive was unpacked
    assert len(known.commit or "") == (40 if in_git else 0)
    assert (known.dirty is None) == (not in_git)
