"""A verdict, a model and an id are told apart by every command that takes one."""

import shutil

import numpy as np
import pytest

from flows.cli import main
from tests.checkout import ROOT
from tests.residual.test_model_record import model_of
from warehouse.record_commit import commit_run

HAS_NO_MODEL = "holds a verdict, expected a model"
FILE = {
    "p.json": "The file holds a verdict. Expected the id of a stored diagnosis",
    "m.json": "The file holds a model. modelgap predict takes it with --model",
}
CASES = {
    "export p.json --to urdf --out o": HAS_NO_MODEL,
    "predict A.csv --model p.json": HAS_NO_MODEL,
    "next m.json A.csv --robot irb140": "holds a model, expected a verdict",
    **{f"adopt {name}": said for name, said in FILE.items()},
    **{f"show {name} --store store": said for name, said in FILE.items()},
    **{f"rerun {name}": said for name, said in FILE.items()},
    **{f"diff {name} {name}": said for name, said in FILE.items()},
    **{f"identify A.csv --robot irb140 --model {n}": s for n, s in FILE.items()},
    **{f"diagnose A.csv --robot irb140 --model {n}": s for n, s in FILE.items()},
    "monitor m.json 3f2a": "m.json is a JSON file. MODEL is the id of a stored diag",
    "show A.csv --store store": "modelgap import gives a log an id",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "tests" / "frozen" / "effects.json", "p.json")
    shutil.copy(ROOT / "examples" / "hidden" / "fit_1.csv", "A.csv")
    model_of(["viscous"]).save("m.json")
    rng = np.random.default_rng(1)
    import modelgap as mg

    log = mg.Recording("", "irb140", np.arange(50) / 100, *rng.normal(size=(2, 50, 6)))
    commit_run(tmp_path / "store", log, {"spec": {"robot": "irb140"}})
    return tmp_path


@pytest.mark.parametrize("words", CASES)
def test_a_file_where_something_else_is_meant_is_called_what_it_is(folder, words, capsys):
    assert main(words.split()) == 2
    text = " ".join(capsys.readouterr().err.split())
    assert CASES[words] in text
    assert "of form" not in text
