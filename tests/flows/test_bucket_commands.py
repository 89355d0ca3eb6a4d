"""Commands on a store in a bucket, as a user gives them."""

import json

import pytest

SPEC = """
schema = 1
robot = "irb140"
seed = 3
[trajectory]
kind = "cyclic"
duration = 3.0
periods = 1
"""


@pytest.fixture
def run(bucket_store, tmp_path, monkeypatch, cli):
    monkeypatch.setenv("MODELGAP_STORE", bucket_store)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return cli


@pytest.mark.slow
def test_a_run_is_made_asked_for_verified_and_made_again(
    run, bucket_store, tmp_path, compiled_plant
):
    code, out, err = run("runs")
    assert code == 2
    assert f"There is no store at {bucket_store}" in err
    (tmp_path / "work" / "spec.toml").write_text(SPEC)
    code, out, _ = run("experiment", "spec.toml")
    id = out.split()[-1]
    assert (code, f"stored in {bucket_store}:" in " ".join(out.split())) == (0, True)
    code, out, _ = run("experiment", "spec.toml")
    assert (code, "is there" in out) == (0, True)
    query = "SELECT run_id, count(*) AS n, max(t) AS last FROM samples GROUP BY run_id"
    code, out, _ = run("sql", query, "--format", "json")
    assert (code, json.loads(out)) == (0, [{"run_id": id, "n": 751, "last": 3.0}])
    code, out, _ = run("verify")
    assert (code, "verified 1 runs, 1 sealed" in out) == (0, True)
    code, out, _ = run("rerun", id[:6], "--verify")
    assert (code, "bit for bit" in out) == (0, True)
    # Nothing but what was asked for lies about.
    assert {path.name for path in (tmp_path / "work").iterdir()} == {"spec.toml"}
