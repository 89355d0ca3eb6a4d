"""Fit many rows in a process of its own and print seconds and peak memory as JSON."""

import json
import sys
from pathlib import Path

from benchmarks.plsr_parts.speed import random_rows, seconds, warm
from residual.tables.nominal_pls import NominalForm, fit_nominal_pls


def main() -> None:
    warm()
    X, Y = random_rows(int(sys.argv[1]))
    spent = seconds(lambda: fit_nominal_pls(X, Y, NominalForm()), 3)
    print(json.dumps({"seconds": spent, "gigabytes": _peak()}))


def _peak() -> float:
    """Peak resident memory of this program [GB].

    Not getrusage(): a process starts with the peak of the one that started it, which
    here has just held the columns of the peers.
    """
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(x.split()[1]) / 1e6 for x in lines if x.startswith("VmHWM"))


if __name__ == "__main__":
    main()
