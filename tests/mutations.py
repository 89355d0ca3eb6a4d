"""Put known faults into a copy of the core, one by one: do the tests see them?

    python -m tests.mutations                     all faults, about an hour
    python -m tests.mutations --only drive.py --minutes 10

Each fault of mutations.toml runs the tests of its folder, those of its own file first,
until the first one fails.
Exit code 1 where a fault is not caught; a text that is not there once is an error.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from time import monotonic

from tests.checkout import ROOT

FAULTS = Path(__file__).with_name("mutations.toml")
NEAR = 4  # files of tests that are tried before all others are loaded
# The tests of a folder of the core; those of all others are tests/residual.
TESTS = {
    "residual/check": ["tests/residual/check"],
    "residual/drive.py": ["tests/residual", "tests/warehouse/test_read_log.py"],
    "residual/robot": ["tests/residual", "tests/test_any_robot.py"],
}


def copy_checkout(folder: Path) -> None:
    """Copy what git tracks, as it is in the working tree."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True
    ).stdout
    for name in filter(None, listed.decode().split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes((ROOT / name).read_bytes())


def order_tests(folder: Path, file: str) -> list[str]:
    """Return the tests of a file of the core: those that import it first, short before long."""
    where, module = os.path.dirname(file), file.removesuffix(".py").replace("/", ".")
    places = [folder / p for p in TESTS.get(file) or TESTS.get(where, ["tests/residual"])]
    files = [p for place in places for p in (place.rglob("test_*.py"), [place])[place.is_file()]]

    def distance(path: Path) -> tuple[bool, int]:
        text = path.read_text(encoding="utf-8")
        return module not in text, len(text)

    return [str(path.relative_to(folder)) for path in sorted(files, key=distance)]


def is_caught(folder: Path, file: str, old: str, new: str) -> bool:
    """Whether a test fails where one text of a file is another."""
    path = folder / file
    text = path.read_text(encoding="utf-8")
    if text.count(old) != 1:
        raise SystemExit(f"{file}: '{old}' is there {text.count(old)} times, not once")
    tests = order_tests(folder, file)
    path.write_text(text.replace(old, new), encoding="utf-8")
    try:
        return any(_fails(folder, part) for part in (tests[:NEAR], tests[NEAR:]) if part)
    finally:
        path.write_text(text, encoding="utf-8")


def _fails(folder: Path, tests: list[str]) -> bool:
    words = [sys.executable, "-m", "pytest", "-q", "-x", "-m", "not long", *tests]
    env = {"PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(words, cwd=folder, env=os.environ | env, capture_output=True, text=True)
    if done.returncode not in (0, 1, 2, 5):  # 2: a file cannot be loaded; 5: all are long
        raise SystemExit(done.stdout[-2000:] + done.stderr[-2000:])
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAILED")]
    print(f"    {(failed or ['nothing failed'])[0][:100]}", flush=True)
    return done.returncode in (1, 2)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="a part of the file's name")
    parser.add_argument("--minutes", type=float, default=60.0)
    args = parser.parse_args()
    faults = tomllib.loads(FAULTS.read_text(encoding="utf-8"))["faults"]
    chosen = [fault for fault in faults if args.only in fault[0]]
    os.nice(10)
    start, caught, missed = monotonic(), 0, []
    with tempfile.TemporaryDirectory() as folder:
        copy_checkout(Path(folder))
        for number, (file, old, new) in enumerate(chosen, start=1):
            if monotonic() - start > 60 * args.minutes:
                print(f"stopped before fault {number}: {args.minutes:g} minutes are over")
                break
            print(f"[{number}/{len(chosen)}] {file}: {new}", flush=True)
            if is_caught(Path(folder), file, old, new):
                caught += 1
            else:
                missed.append(f"{file}: {old} -> {new}")
    print(f"{caught} caught, {len(missed)} not")
    print(*missed, sep="\n")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
