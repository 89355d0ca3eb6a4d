"""Bad words of every command: exit code 2, a line or two, no file."""

import io
import os
import shutil

import numpy as np
import pytest

from flows.cli import main
from tests.checkout import ROOT
from tests.residual.identified import workplace
from tests.residual.test_model_record import model_of
from tests.warehouse import store_samples
from warehouse.record_commit import commit_run

ROBOT = "--robot arm.urdf"
# What stands for itself with any of the verbs that fit something to logs.
OF_ALL = {
    "V A.csv": "modelgap: V needs --robot ROBOT. See modelgap V --help.",
    f"V {ROBOT}": "No log to ",
    "V A.csv --robot arm.urd": "No file or folder 'arm.urd'",
    "V A.csv --robot irb14": "did you mean 'irb140'",
    f"V A.csv {ROBOT} --declared coulom": "did you mean 'coulomb'",
    f"V A.csv {ROBOT} --map no.toml": "Cannot read no.toml",
    f"V A.csv {ROBOT} --json A.csv": "overwrite an input",
    f"V D.csv {ROBOT}": "MCAP or ROS bag file, or",
    f"V abcdef12 {ROBOT} --store nowhere": "abcdef12",
}
VERBS = ("diagnose", "identify", "calibrate", "check")
BAD = {
    "diagnos": 'Did you mean "diagnose"',
    "diagnose A.csv --robo arm.urdf": "Did you mean --robot",
    "diagnose A.csv --robot": "parameter --robot requires an argument",
    f"diagnose A.csv {ROBOT} --holdout": "parameter --holdout requires",
    f"diagnose A.csv {ROBOT} --json": "parameter --json requires an argument",
    f"diagnose {ROBOT} --holdout A.csv": "No log to diagnose",
    f"diagnose A.csv {ROBOT} --declared viscous,": "Unknown effect",
    f"diagnose A.csv {ROBOT} --declared none,viscous": "Unknown effect",
    f"diagnose A.csv@0:9 {ROBOT}": "outside the log",
    f"diagnose A.csv B.csv {ROBOT} --holdout A.csv": "hold the same samples",
    f"diagnose A.csv {ROBOT} --report no/o.html": "no folder 'no'",
    f"diagnose A.csv {ROBOT} --report .": "is a folder",
    f"diagnose A.csv {ROBOT} --report A.csv": "overwrite an input",
    f"diagnose A.csv {ROBOT} --json o --report ./o": "both name",
    f"identify A.csv {ROBOT} --method wsl": "did you mean 'wls'",
    f"identify A.csv {ROBOT} --prior 0": "expected a positive number",
    f"identify A.csv {ROBOT} --prior x": "prior",
    f"identify A.csv {ROBOT} --out A.csv": "is a file, expected a folder",
    f"identify A.csv {ROBOT} --out .": "is not empty",
    f"identify A.csv {ROBOT} --out no/new": "no folder 'no'",
    f"identify A.csv@0:1.6 {ROBOT}": "expected at least 2 s",
    f"calibrate A.csv B.csv {ROBOT} --paper": "A has no reference",
    f"calibrate A.csv {ROBOT} --holdout B.csv": "calibrate validates by leaving out each log (or",
    f"calibrate A.csv {ROBOT} --levels 4,x": "--levels 4,x: expected whole numbers",
    f"import {ROBOT}": "No log to import",
    "import A.csv --robot arm": "Unknown robot 'arm'",
    f"import no.csv {ROBOT}": "No log file 'no.csv'",
    f"import A.csv A.csv {ROBOT}": "are one run",
    "import A.csv --robot irb140": "missing column",
    f"import A.csv {ROBOT} --map no.toml": "Cannot read no.toml: No such file",
    f"import arm.urdf {ROBOT}": "arm.urdf",
    f"import . {ROBOT}": "is a folder, expected a log file",
    f"import A.csv {ROBOT} --trajectory {'x' * 99}": "expected a short name",
    f"import A.csv {ROBOT} --store A.csv": "is a file, not a folder",
    "demo --effect stribek": "did you mean 'stribeck'",
    "demo --seed x": "seed",
    "demo --seed -1": "expected 0 to",
    "trajectory weldin": "did you mean 'welding'",
    "trajectory cyclic --duration 3 --periods 2": "breaks its",
    "trajectory cyclic --out no/such/out.csv": "no folder",
    "trajectory cyclic --robot nosuch": "irb140",
    "trajectory": "trajectory needs FAMILY. See modelgap trajectory --help",
    "trajectory cyclic --robot": "parameter --robot requires an argument",
    "monitor": "monitor needs MODEL.",
    "monitor x --robot irb140": "--robot. MODEL is the robot, or the id of a",
    "trajectory cyclic --rate 1e9": "--rate 1e+09: expected 1 to 20000",
    "trajectory cyclic --duration nan": "--duration nan: expected",
    "trajectory cyclic --periods 0": "--periods 0: expected",
    f"import A.csv {ROBOT} --recorded-at yesterday": "expected a date with time and",
    f"import A.csv {ROBOT} --recorded-at 2026-11-20T14:03:00": "with time and zone",
    f"import A.csv {ROBOT} --tag cell=4 --tag cell=5": "set one key twice",
    f"import A.csv {ROBOT} --tag =4": "expected a word, or KEY=VALUE",
    f"import A.csv {ROBOT} --serial a/b": "expected a text of 1 to 40 letters",
    "runs --store s3:/robots/cell": "a folder, or s3://BUCKET/PREFIX",
    "runs --store s3://r/cell": "BUCKET has 3 to 63",
    "runs --store nowhere": "There is no store at",
    "runs --store .": "is no store: expected folders such as samples",
    "verify --store .": "is no store: expected folders such as samples",
    "runs --limit 0": "expected 1 or more",
    "runs --format xml": "--format",
    "sql": "Give one of",
    "sql --schema --named findings": "Give one of",
    "sql --named runs_of_model": "takes --with model=...",
    "sql --named findings --with a=1": "takes no --with",
    "sql FROM/**/runs --with a=1": "--with sets a value of",
    "sql FROM/**/runs --out nowhere/a.csv": "there is no folder",
    "sql --named finding": "did you mean 'findings'",
    "sql FROM": 'Parser Error: syntax error at or near "FROM". modelgap sql --schema',
    "sql FROM/**/runz": 'Did you mean "runs"? modelgap sql --schema names the views',
    "sql SELECT/**/no/**/FROM/**/runs": ". modelgap sql --schema names the views and",
    "sql COPY/**/runs/**/TO'x.csv'": "got COPY",
    "sql FROM'/etc/passwd'": "does not exist",
    "show": "See modelgap show --help",
    "predict A.csv": "predict needs --model MODEL.",
    "store diff 3f2a": "store diff needs TWO. See modelgap store diff --help",
    "show ../../etc": "is not an id",
    "show 00000000000000000000": "has an id that begins with",
    "rollback irb140": "See modelgap rollback --help",
    "status now then": "See modelgap status --help",
}
BAD |= {
    words.replace("V", verb, 1): message.replace("V", verb)
    for words, message in OF_ALL.items()
    for verb in VERBS
    # It takes no --declared, and without a log looks at the robot file.
    if not (verb == "check" and ("--declared" in words or words == f"V {ROBOT}"))
}


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = workplace(tmp_path_factory.mktemp("logs"), "AB", 8.0)
    store_samples.commit(folder / "store")
    return folder


@pytest.mark.parametrize("words", BAD)
def test_bad_words_end_with_two_and_at_most_two_lines(logs, monkeypatch, capsys, words):
    monkeypatch.chdir(logs)
    monkeypatch.delenv("MODELGAP_STORE", raising=False)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    before = sorted(os.listdir(logs))
    assert main(words.split()) == 2
    shown = capsys.readouterr()
    assert BAD[words] in shown.err
    assert shown.err.startswith("modelgap: ")
    assert 1 <= shown.err.count("\n") <= 2
    assert sorted(os.listdir(logs)) == before


# A verdict, a model and an id are told apart by every command that takes one.


HAS_NO_MODEL = "holds a verdict, expected a model"
FILE = {
    "p.json": "The file holds a verdict. Expected the id of a stored diagnosis",
    "m.json": "The file holds a model. Give it to modelgap predict with --model",
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
