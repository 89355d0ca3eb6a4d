"""Many experiments: over processes, resumed, one failure not fatal."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from flows.cli import main
from flows.specs import parse_spec
from flows.steps import experiment
from flows.steps.experiment import plan_experiments, run_campaign_experiments
from flows.workers import InlineExecutor, JobResult, ProcessExecutor, run_jobs
from residual.errors import InputError
from tests.checkout import ROOT
from tests.waiting import PATIENCE, until


def specs(count: int) -> list:
    experiments = [parse_spec({"seed": i}, "S") for i in range(count)]
    return [(f"seed={i}", spec) for i, spec in enumerate(experiments)]


@pytest.fixture
def done(monkeypatch):
    """Replace the experiment by a folder in its place; returns the seeds that ran."""
    ran = []

    def run(spec, store, campaign=None):
        ran.append(spec.seed)
        (store.parent / "named").write_text(str(campaign))
        if spec.seed == 1:
            raise InputError("joint 2 at 1.2 s:\n0.3 rad beyond")
        if spec.seed == 2:
            raise ZeroDivisionError("a fault")
        id = experiment.compute_run_id(spec)
        (store / "samples" / "robot=irb140" / f"run_id={id}").mkdir(parents=True)
        return id

    monkeypatch.setattr(experiment, "simulate_and_store", run)
    return ran


def test_one_failure_is_reported_and_the_others_go_on(tmp_path, done):
    planned = plan_experiments(specs(4), tmp_path)
    progress = []
    summary = run_campaign_experiments(
        planned, tmp_path, lambda *a: progress.append(a), InlineExecutor()
    )
    assert done == [0, 1, 2, 3]
    assert list(summary.failed.values()) == [
        "seed=1: joint 2 at 1.2 s: 0.3 rad beyond",
        "seed=2: ZeroDivisionError: a fault",
    ]
    assert summary.stored == (planned[0].run_id, planned[3].run_id)
    assert progress[-1] == ("stored 4 of 4: seed=3", 1.0)


def test_the_same_command_completes_what_was_left(tmp_path, done):
    run_campaign_experiments(
        plan_experiments(specs(1), tmp_path), tmp_path, executor=InlineExecutor()
    )
    planned = plan_experiments(specs(5), tmp_path)
    assert [p.stored for p in planned] == [True, False, False, False, False]
    summary = run_campaign_experiments(planned, tmp_path, executor=InlineExecutor())
    assert done == [0, 1, 2, 3, 4]
    assert summary.new == (planned[3].run_id, planned[4].run_id)


MOTIONS = """
trajectory.kind = "cyclic"
trajectory.duration = 4.0
[grid]
trajectory.periods = [1, 60]
"""


def test_a_dry_run_plans_the_motions_and_says_which_break_a_limit(tmp_path, capsys):
    (tmp_path / "C.toml").write_text(MOTIONS)
    store = tmp_path / "store"
    words = ["campaign", str(tmp_path / "C.toml"), "--store", str(store), "--dry-run"]
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "to run    trajectory.periods=1\n" in shown
    assert "fails     trajectory.periods=60\n" in shown
    assert f"2 to run, 0 in {store}; 1 will fail" in shown
    assert not store.exists()


def test_a_campaign_with_a_failure_ends_with_1_and_says_which(tmp_path, done, monkeypatch, capsys):
    monkeypatch.setattr(experiment, "ProcessExecutor", lambda workers: InlineExecutor())
    (tmp_path / "C.toml").write_text("[grid]\nseed = [0, 1]\n")
    words = ["campaign", str(tmp_path / "C.toml"), "--store", str(tmp_path / "s")]
    assert main(words) == 1
    shown = capsys.readouterr()
    assert "failed: seed=1: joint 2 at 1.2 s: 0.3 rad beyond" in shown.out
    assert "1 of 2 experiments failed" in shown.err
    assert "A spec that cannot run fails again" in shown.err
    assert (tmp_path / "named").read_text() == "C"  # its runs have its name


@pytest.fixture(scope="module")
def pool():
    with ProcessExecutor(2) as made:
        yield made


def by_index(pool, work, jobs) -> list[JobResult]:
    return sorted(run_jobs(pool, work, jobs), key=lambda d: d.index)


def test_a_process_that_dies_takes_no_other_job_with_it(pool):
    done = by_index(pool, eval, ["1", "2", "__import__('os')._exit(3)", "4", "5"])
    assert [d.value for d in done] == [1, 2, None, 4, 5]
    assert "the worker process died" in str(done[2].error)


# A suite that a shell started in the background inherits a deaf ear for Ctrl-C.
_SLEEPERS = """
import signal, time
from flows.workers import ProcessExecutor, run_jobs
signal.signal(signal.SIGINT, signal.default_int_handler)
if __name__ == "__main__":
    with ProcessExecutor(2) as pool:
        for done in run_jobs(pool, time.sleep, [0.5, 0.5, 600.0, 600.0]):
            print("done", *pool._pids, flush=True)
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_no_process_outlives_its_parent(tmp_path, how):
    script = tmp_path / "sleepers.py"
    script.write_text(_SLEEPERS)
    process = subprocess.Popen(
        [sys.executable, str(script)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    process.stdout.readline()
    workers = [int(word) for word in process.stdout.readline().split()[1:]]
    process.send_signal(how)
    process.wait(PATIENCE)
    until(lambda: not any(map(_lives, workers)), "all workers have ended")


def _lives(pid: int) -> bool:
    try:
        # Empty where it has ended and nobody has taken note yet.
        return bool(Path(f"/proc/{pid}/cmdline").read_bytes())
    except OSError:
        return False
