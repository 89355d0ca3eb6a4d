"""Run a command of the program in a process of its own and measure it."""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from time import perf_counter

from benchmarks.harness.origin import ROOT

# The same as the console script, also where that is not installed.
_START = "import sys; from flows.cli import main; sys.exit(main())"


@dataclass(frozen=True, slots=True)
class Command:
    """A finished command."""

    code: int  # exit code
    output: str
    seconds: float  # wall time [s]
    gigabytes: float  # peak resident memory


def run_command(words: list[str], folder: str) -> Command:
    foreign = ("MODELGAP", "PREFECT")
    env = {k: v for k, v in os.environ.items() if not k.startswith(foreign)}
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    with tempfile.TemporaryFile("w+") as output:
        start = perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-c", _START, *words],
            cwd=folder,
            env=env | {"PYTHONPATH": path},
            stdout=output,
            stderr=output,
        )
        _, status, usage = os.wait4(process.pid, 0)
        seconds = perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        # Linux counts in kilobytes.
        gigabytes = usage.ru_maxrss / 1e6
        return Command(process.returncode, output.read(), seconds, gigabytes)
