"""A null from the command line: made, kept, gone on with, and found by a diagnosis."""

import json

import pytest

from flows.requests import Null
from flows.steps import null as steps
from flows.storage import null as keep
from flows.storage.null import null_json, nulls_in, read_null
from flows.workers.pool import Here
from residual.errors import InputError
from tests.residual.arms import arm, short_case, urdf_text, write_csv


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a small arm and two short logs of it, and no other store."""
    monkeypatch.setenv("MODELGAP_STORE", str(tmp_path / "store"))
    (tmp_path / "arm.urdf").write_text(urdf_text())
    for log in short_case(arm(), seed=51, duration=6.0).fit[:2]:
        write_csv(tmp_path / f"{log.id}.csv", log)
    return tmp_path


def asked(place, **changes):
    logs = tuple(sorted(str(p) for p in place.glob("*.csv")))
    return Null(logs, robot=str(place / "arm.urdf"), **{"draws": 8, **changes})


class Breaks(Here):
    """Ctrl-C after the first block."""

    def run(self, work, jobs):
        yield from list(super().run(work, jobs[:1]))
        raise KeyboardInterrupt


def test_what_an_interrupted_run_finished_is_kept_and_gone_on_with(place):
    part = steps.calibrate_null(asked(place), pool=Breaks())
    assert not part.complete
    assert len(part.null.net) == steps.OF_A_BLOCK
    whole = steps.calibrate_null(asked(place), pool=Here())
    assert whole.complete
    assert whole.known == steps.OF_A_BLOCK
    assert len(whole.null.net) == 8
    assert whole.null.net[: steps.OF_A_BLOCK] == part.null.net
    again = steps.calibrate_null(asked(place), pool=Here())
    assert again.known == 8
    assert again.null.id == whole.null.id
    kept = nulls_in(place / "store")
    assert [n.id for n in kept] == [whole.null.id, part.null.id]
    assert kept[0].key == whole.null.key


class InThisProcess(Here):
    """A pool that starts no process."""

    def __init__(self, workers):
        assert workers == 1

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


def test_the_command_says_the_rate_and_writes_the_file(place, monkeypatch, capsys):
    from flows.cli import main

    monkeypatch.setattr(steps, "Pool", InThisProcess)
    wanted = asked(place)
    words = [*wanted.logs, "--robot", wanted.robot, "--draws", "4", "--workers", "1"]
    assert main(["calibrate-null", *words, "--out", str(place / "n.json")]) == 0
    told = capsys.readouterr().out
    assert "of 4 recordings with nothing missing were given a name" in told
    assert "an extrapolation" in told
    id = read_null(str(place / "n.json")).id
    assert f"modelgap show {id}" in told
    assert main(["show", id]) == 0
    assert main(["calibrate-null", *words, "--workers", "0"]) == 2
    assert main(["calibrate-null", *words, "--baseline", wanted.logs[0]]) == 2
    assert "needs no null" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "word"), [("{}", "is no null"), ("x", "no JSON"), ("[]", "is no null")]
)
def test_a_file_that_is_no_null_is_refused(place, text, word):
    file = place / "other.json"
    file.write_text(text)
    with pytest.raises(InputError, match=word):
        read_null(str(file))
    with pytest.raises(InputError, match="cannot be read"):
        read_null(str(place / "none.json"))


def test_a_request_that_makes_no_sense_is_refused(place):
    for changes, word in (
        ({"draws": 0}, "--draws is 0"),
        ({"declared": ("friction",)}, "friction"),
    ):
        with pytest.raises(InputError, match=word):
            steps.calibrate_null(asked(place, **changes), pool=Here())
    with pytest.raises(InputError, match="No log"):
        steps.calibrate_null(Null((), robot=str(place / "arm.urdf")), pool=Here())


def test_a_diagnosis_finds_the_null_of_its_logs_in_the_store(place, capsys):
    from flows.cli import main

    null = steps.calibrate_null(asked(place, draws=4), pool=Here()).null
    words = [*asked(place).logs, "--robot", str(place / "arm.urdf")]
    assert main(["diagnose", *words, "--json", str(place / "v.json")]) == 0
    verdict = json.loads((place / "v.json").read_text())
    assert any(w.startswith(f"null {null.id}") for w in verdict["warnings"])
    empty = ["--store", str(place / "empty")]
    assert main(["diagnose", *words, *empty, "--json", str(place / "w.json")]) == 0
    assert "is a constant" in capsys.readouterr().out
    other = json.loads((place / "w.json").read_text())
    assert not any(w.startswith("null ") for w in other["warnings"])


def test_a_null_of_another_version_of_the_method_is_not_used(place, monkeypatch):
    from flows.cli import main

    null = steps.calibrate_null(asked(place, draws=4), pool=Here()).null
    assert null.method == keep.method_hash()
    (place / "n.json").write_text(null_json(null))
    words = [*asked(place).logs, "--robot", str(place / "arm.urdf")]
    monkeypatch.setattr(keep, "method_hash", lambda: "0123456789abcdef")
    for more in ([], ["--null", str(place / "n.json")]):
        assert main(["diagnose", *words, *more, "--json", str(place / "v.json")]) == 0
        verdict = json.loads((place / "v.json").read_text())
        told = [w for w in verdict["warnings"] if w.startswith("null ")]
        assert len(told) == 1
        assert f"null {null.id} is not used" in told[0]
        assert null.method in told[0]
        assert "this is 0123456789abcdef" in told[0]
        assert all(e["evidence"]["p_value"] is None for e in verdict["effects"])
