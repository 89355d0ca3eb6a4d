import io
import json
import subprocess
import sys

import numpy as np
import pytest

from residual.calibration.correction_choice import MAIN, CorrectionOption
from residual.calibration.nominal_pls import NominalPlsForm, fit_nominal_pls
from residual.errors import InputError
from residual.model.lookup import LevelAxis, Lookup, LookupTable, build_lookup_files
from tests.residual.motion_blocks import motion
from tests.residual.test_choice import fitted

EXACT = {"rtol": 0, "atol": 1e-12}


@pytest.fixture(scope="module")
def block():
    return motion(np.random.default_rng(5), runs=3, rows=400)


@pytest.fixture(scope="module")
def model(block):
    return fit_nominal_pls(block[0], block[1], NominalPlsForm(9, 5))


@pytest.mark.parametrize("components", [1, 5, None])
def test_tables_equal_the_paper_form(block, model, components):
    lookup = model.lookup(components)
    expected = model.predict(block[0], components)
    np.testing.assert_allclose(lookup.predict(block[0]), expected, **EXACT)


@pytest.mark.parametrize("joints", [1, 3, 4, 6])
def test_any_number_of_joints_and_kinds_of_table_add_up(rng, joints):
    edges = np.array([-0.5, 0.0, 0.001, 0.7])
    one, two = rng.normal(size=(5, joints)), rng.normal(size=(5, 2, joints))
    slope, offset = rng.normal(size=(3, joints)), rng.normal(size=joints)
    lookup = Lookup(
        ("a", "b", "c"),
        tuple(f"joint {j}" for j in range(joints)),
        (LevelAxis(2, edges), LevelAxis(0, np.array([0.25]))),
        (LookupTable((0,), one), LookupTable((0, 1), two)),
        offset,
        slope,
        np.array([-1.0, -1, -1]),
        np.array([1.0, 1, 1]),
    )
    X = rng.normal(size=(200, 3))
    X[:5, 2] = [*edges.tolist(), np.nextafter(0.7, 0)]
    i, j = np.searchsorted(edges, X[:, 2], "right"), (X[:, 0] >= 0.25).astype(int)
    expected = offset + X @ slope + one[i] + two[i, j]
    np.testing.assert_allclose(lookup.predict(X), expected, **EXACT)
    np.testing.assert_array_equal(lookup.outside(X), np.abs(X) > 1)


def _evaluated(files, tmp_path, X):
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    np.savetxt(tmp_path / "rows.csv", X, "%.17g", delimiter=",")
    # -I: neither this folder nor PYTHONPATH, so that our package cannot be found.
    words = [sys.executable, "-I", "evaluate.py", "model.npz", "rows.csv"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert done.stderr == ""
    return np.loadtxt(io.StringIO(done.stdout), delimiter=",", ndmin=2)


def test_the_export_evaluates_on_its_own(block, model, tmp_path):
    X, Y, torque, _ = block
    files = build_lookup_files(model.lookup())
    assert set(files) == {"model.npz", "tables.csv", "model.json", "evaluate.py"}
    assert files == build_lookup_files(model.lookup())
    document = json.loads(files["model.json"])
    assert document["tables"][0]["variables"] == ["x1", "x2"]
    assert [len(axis["edges"]) for axis in document["axes"]] == [8] * 9
    assert "residual" not in files["evaluate.py"].decode()
    evaluated = _evaluated(files, tmp_path, X[::20])
    np.testing.assert_allclose(evaluated, model.predict(X[::20]), **EXACT)
    own = fitted(X, Y, torque).lookup([CorrectionOption(MAIN, 20.0)] * 3)
    evaluated = _evaluated(build_lookup_files(own), tmp_path, X[::20])
    np.testing.assert_allclose(evaluated, own.predict(X[::20]), **EXACT)


def test_bad_rows_are_refused(model):
    lookup = model.lookup()
    with pytest.raises(InputError, match="X has 2 columns, the tables are of 9"):
        lookup.predict(np.ones((3, 2)))
    with pytest.raises(InputError, match="NaN or infinite in row 0"):
        lookup.predict(np.full((1, 9), np.nan))
    with pytest.raises(InputError, match="components must be 0 to 5, got 6"):
        model.lookup(6)
