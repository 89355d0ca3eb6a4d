"""The command line: words in, exit codes, messages and files out."""

import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import fields, replace

import pytest

from flows.cli import app, main
from flows.requests import Diagnose, format_command
from residual.diagnosis import diagnose as loop
from tests.checkout import ROOT


def run(words):
    return main(words.split())


def ids(recordings):
    return [recording.id for recording in recordings]


SETS = {
    "diagnose A.csv --robot irb140": ("A", "", ""),
    "diagnose A.csv B.csv --robot irb140 --holdout C.csv": ("A B", "", "C"),
    "diagnose A.csv --robot irb140 --baseline B.csv C.csv": ("A", "B C", ""),
    "diagnose A.csv --baseline B.csv --robot irb140 --holdout C.csv": ("A", "B", "C"),
    "diagnose --robot irb140 A.csv B.csv": ("A B", "", ""),
    "diagnose --robot irb140 --baseline B.csv -- A.csv": ("A", "B", ""),
    "diagnose --robot=irb140 A.csv --holdout=B.csv C.csv": ("A", "", "B C"),
}


@pytest.mark.parametrize("words", SETS)
def test_every_log_goes_into_the_set_that_the_words_say(folder, calls, capsys, words):
    assert run(words) == 0
    fit, baseline, held_out = SETS[words]
    call = calls[0]
    assert ids(call["fit"]) == fit.split()
    assert ids(call["baseline"]) == baseline.split()
    assert ids(call["held_out"]) == held_out.split()
    shown = capsys.readouterr().out
    line = f"fit: {fit} | baseline: {baseline or '–'} | held out: {held_out or '–'}\n"
    assert line in shown
    (read,) = [line for line in shown.splitlines() if "; read " in line]
    names, _, about = read.partition(": ")
    assert sorted(names.split(", ")) == sorted(re.findall(r"(\w)\.csv", words))
    assert about == "300 samples, 100 Hz, 2.99 s; read t q1..6 tau1..6"
    assert "verdict none" in shown


def test_the_command_on_a_page_gives_its_request_again():
    """With every option; a new one is to have a value here."""
    request = Diagnose(
        ("A.csv", "B c.csv"),
        robot="irb140",
        baseline=("h.csv",),
        held_out=("C.csv", "D.csv"),
        declared=(),
        columns="m.toml",
        known=("payload.mass=2",),
        store="s",
        trust_log=True,
        model="ab",
    )
    usual = {f.name for f in fields(request) if getattr(request, f.name) == f.default}
    assert usual == {"chain", "tip", "xacro_args", "package_dirs"}  # with the robot
    words = shlex.split(format_command(request, "--report", "o.html"))
    _, bound, _ = app.parse_args(words[1:], print_error=False, exit_on_error=False)
    given = bound.arguments
    assert replace(given["request"], logs=given["logs"]) == request
    assert given["report"] == "o.html"


@pytest.mark.parametrize("json_words", ["--json -", "--json=-"])
def test_json_on_standard_output_is_alone_there(folder, calls, capsys, json_words):
    assert run(f"diagnose A.csv --robot irb140 {json_words} --holdout B.csv") == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["verdict"] == "none"
    assert "fit: A | baseline: – | held out: B" in shown.err


def test_a_failure_of_the_program_is_one_and_hints_at_the_trace(folder, calls, capsys, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("of a\nstrange kind")

    monkeypatch.setattr("residual.diagnosis.diagnose.diagnose", fail)
    assert run("diagnose A.csv --robot irb140 --report o.html") == 1
    shown = capsys.readouterr().err
    assert shown == (
        "modelgap: unexpected failure: RuntimeError: of a strange kind\n"
        "Set MODELGAP_TRACEBACK=1 to see where.\n"
    )
    assert not (folder / "o.html").exists()
    monkeypatch.setenv("MODELGAP_TRACEBACK", "1")
    assert run("diagnose A.csv --robot irb140") == 1
    assert "Traceback" in capsys.readouterr().err


def test_an_interruption_is_one_hundred_and_thirty(folder, calls, capsys, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("residual.diagnosis.diagnose.diagnose", interrupt)
    assert run("diagnose A.csv --robot irb140 --report o.html") == 130
    assert capsys.readouterr().err == "modelgap: interrupted\n"
    assert sorted(os.listdir(folder)) == ["A.csv", "B.csv", "C.csv"]


def test_a_verdict_with_nan_is_never_written(folder, calls, monkeypatch):
    close = loop.diagnose

    def spoiled(*words, **options):
        diagnosis = close(*words, **options)
        spoiled = replace(diagnosis.verdict, nominal_scale=float("nan"))
        return replace(diagnosis, verdict=spoiled)

    monkeypatch.setattr("residual.diagnosis.diagnose.diagnose", spoiled)
    assert run("diagnose A.csv --robot irb140 --report o.html --json o.json") == 0
    text = (folder / "o.json").read_text()
    assert "NaN" not in text
    assert json.loads(text)["nominal_scale"] is None


def test_a_closed_output_is_exit_code_1_without_a_traceback():
    read, write = os.pipe()
    os.close(read)
    code = "import sys; from flows.cli import main; sys.exit(main(['--help']))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, text=True, stdout=write, stderr=subprocess.PIPE
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (1, "")
