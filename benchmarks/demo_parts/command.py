"""What `modelgap demo` costs from the shell, in time and memory."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.figures import ROOT, Figures, figure, missing

SECONDS, GIGABYTES = 90.0, 1.5
_EVERY = 0.2  # s between two looks at the memory
# The same as the console script, also where that is not installed.
_MODELGAP = (
    sys.executable,
    "-c",
    "from flows.cli import main; raise SystemExit(main())",
)


def command_figures() -> Figures:
    """Time `modelgap demo` in an empty store, with the memory of all its processes."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["demo", "--store", str(Path(folder) / "store")]
        code, said, seconds, peak = _watched([*_MODELGAP, *words], folder)
        made = list(Path(folder).glob("store/reports/*/report.html"))
    if code or not made:
        why = f"the command failed: {said.strip()[-300:]}"
        failed = {"ok": False}
        return {
            "demo_seconds": missing(SECONDS, why) | failed,
            "demo_peak_gb": missing(GIGABYTES, why) | failed,
        }
    return {
        "demo_seconds": figure(round(seconds, 1), SECONDS, 1, cores=os.cpu_count()),
        "demo_peak_gb": figure(round(peak, 3), GIGABYTES, 1, of="all its processes"),
    }


def _watched(command: list[str], folder: str) -> tuple[int, str, float, float]:
    """Return exit code, what it said, seconds and peak gigabytes of the whole tree."""
    place = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    peak, begun = 0, time.perf_counter()
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": place},
            stdout=said,
            stderr=said,
        )
        while process.poll() is None:
            peak = max(peak, sum(map(_kilobytes, _tree(process.pid))))
            time.sleep(_EVERY)
        seconds = time.perf_counter() - begun
        said.seek(0)
        return process.returncode, said.read(), seconds, peak / 1e6


def _tree(root: int) -> list[int]:
    """Return a process and all that descend from it."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            # The name, in parentheses, may hold blanks; what follows does not.
            parent = int(entry.read_text().rpartition(")")[2].split()[1])
        except (OSError, IndexError):
            continue
        children.setdefault(parent, []).append(int(entry.parent.name))
    found, todo = [], [root]
    while todo:
        found.append(todo.pop())
        todo += children.get(found[-1], [])
    return found


def _kilobytes(process: int) -> int:
    """Return resident memory; pages that several processes share count in parts."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line[:4] == "Pss:"), 0)
