"""Write what the commands say of fixed logs: python tests/frozen/make.py FOLDER.

The files beside this one were made before the modules moved into rooms, that of the
calibration when blocks within runs came to be left out; the test holds every later tree
against them.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from flows.cli import main

ROOT = Path(__file__).parents[2]
HIDDEN = ROOT / "examples" / "hidden"
ARM = ("--robot", "irb140")
# Of when and by what it was made; everything else must stay as it was.
PASSING = ("made_by", "created", "provenance", "version", "seconds", "megabytes")


def shaken(folder: Path) -> str:
    """A log in which joint 2 vibrates, which no effect explains."""
    table = np.genfromtxt(HIDDEN / "fit_3.csv", delimiter=",", names=True)
    columns = {name: table[name] for name in table.dtype.names}
    columns["tau2"] = columns["tau2"] + 25 * np.sin(2 * np.pi * 3.1 * columns["t"])
    path = folder / "shaken.csv"
    np.savetxt(
        path,
        np.column_stack(list(columns.values())),
        fmt="%.4f",
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    return str(path)


def commands(folder: Path) -> dict[str, list[str]]:
    names = ("fit_1", "fit_2", "fit_3", "held_out")
    slow, fast, pick, held = (f"{HIDDEN / name}.csv@0:10" for name in names)
    strange, short = f"{shaken(folder)}@0:10", [f"{HIDDEN / n}.csv@0:4" for n in names]
    proof = ["--holdout", held]
    earlier = ["--baseline", slow, fast]
    return {
        "effects": ["diagnose", fast, pick, *ARM, *proof],
        "none": ["diagnose", pick, *ARM, *earlier, *proof],
        "unknown": ["diagnose", strange, *ARM, *earlier],
        "identification": ["identify", fast, pick, *ARM, *proof],
        "calibration": ["calibrate", *short[1:], *ARM],
    }


def lasting(value):
    if isinstance(value, dict):
        return {k: lasting(v) for k, v in value.items() if k not in PASSING}
    return [lasting(v) for v in value] if isinstance(value, list) else value


def document(name: str, folder: Path) -> dict:
    path = folder / f"{name}.json"
    outputs = ["--json", str(path), "--store", str(folder / "none")]
    assert main([*commands(folder)[name], *outputs]) == 0
    return lasting(json.loads(path.read_text(encoding="utf-8")))


if __name__ == "__main__":
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    for name in commands(Path(tempfile.mkdtemp())):
        with tempfile.TemporaryDirectory() as folder:
            text = json.dumps(document(name, Path(folder)), indent=1)
        (out / f"{name}.json").write_text(text + "\n", encoding="utf-8")
        print(name)
