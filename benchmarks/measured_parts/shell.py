"""Group 3: what the command costs from the shell, in time and memory."""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.figures import ROOT, Figures, figure, missing
from benchmarks.synthetic.logs import standard_case
from residual.robot.robot import load_robot

_SECONDS, _GIGABYTES = 15.0, 1.5
# The same as the console script, also where that is not installed.
_MODELGAP = (
    sys.executable,
    "-c",
    "from flows.cli import main; raise SystemExit(main())",
)


def shell_figures(runs: int) -> Figures:
    """Time `modelgap diagnose` on two minutes of six-joint logs at 250 Hz.

    Five logs of 20 s to fit and one held out, as CSV; peak memory is that of the
    process and of what it starts.
    """
    with tempfile.TemporaryDirectory() as folder:
        fit, held_out = _write_logs(Path(folder))
        words = ["diagnose", *fit, "--holdout", held_out, "--robot", "irb140"]
        words += ["--json", str(Path(folder) / "verdict.json")]
        done = [run_shell(words, folder) for _ in range(runs)]
        ok = (Path(folder) / "verdict.json").exists()
    failed = next((each.said for each in done if each.code != 0 or not ok), None)
    if failed is not None:
        why = f"the command failed: {failed.strip()[-300:]}"
        return {
            "shell_seconds": missing(_SECONDS, why) | {"ok": False},
            "shell_peak_gb": missing(_GIGABYTES, why) | {"ok": False},
        }
    seconds = [round(each.seconds, 2) for each in done]
    peak = max(each.gigabytes for each in done)
    return {
        "shell_seconds": figure(float(np.median(seconds)), _SECONDS, runs, all=seconds),
        "shell_peak_gb": figure(round(peak, 3), _GIGABYTES, runs),
    }


def _write_logs(folder: Path) -> tuple[list[str], str]:
    case = standard_case("stribeck", 1, joint=2, robot=load_robot("irb140"))
    header = ",".join(["t", *(f"{x}{j}" for x in ("q", "tau") for j in range(1, 7))])
    paths = []
    for log in (*case.fit[1:], case.held_out[1]):
        paths.append(str(folder / f"{log.id}.csv"))
        rows = np.column_stack([log.t, log.q, log.tau])
        np.savetxt(paths[-1], rows, "%.6f", delimiter=",", header=header, comments="")
    return paths[:-1], paths[-1]


@dataclass(frozen=True, slots=True)
class Ran:
    """A command that has ended.

    Attributes:
        code: Its exit code.
        said: What it printed.
        seconds: On the clock [s].
        cpu: Of the processors [s].
        gigabytes: Peak resident memory.
    """

    code: int
    said: str
    seconds: float
    cpu: float
    gigabytes: float


def run_shell(words: list[str], folder: str) -> Ran:
    """Run a command of modelgap in a folder."""
    plain = dict(os.environ)
    plain["PYTHONPATH"] = os.pathsep.join([str(ROOT), plain.get("PYTHONPATH", "")])
    with tempfile.TemporaryFile("w+") as said:
        start = perf_counter()
        process = subprocess.Popen(
            [*_MODELGAP, *words], cwd=folder, env=plain, stdout=said, stderr=said
        )
        _, status, usage = os.wait4(process.pid, 0)
        seconds = perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        cpu = usage.ru_utime + usage.ru_stime
        # Linux counts in kilobytes.
        return Ran(process.returncode, said.read(), seconds, cpu, usage.ru_maxrss / 1e6)
