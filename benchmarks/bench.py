"""Run every benchmark on one commit.

    make bench                all benchmarks: at most two hours on two cores
    make bench QUICK=1        a part of each, about ten minutes; decides nothing
    python benchmarks/bench.py --only measured diagnosis

Each benchmark writes benchmarks/results/NAME.json with commit, hash of the code, seeds,
machine and date. A benchmark with a result of the present code does not run again, and
an interrupted one continues where it stopped (store/benchmarks): repeat the command. At
the end benchmarks/page.py writes docs/benchmarks.md and the table of the README. A
quick run writes no result. Measured logs are read from $MODELGAP_DATA (else
../shared/data), robot files also from the packages example-robot-data and rtb-data (pip
install --no-deps --target FOLDER, and FOLDER in $PYTHONPATH); without them these figures
are not measured. The last line of a benchmark is one JSON object. Exit code 1: a bar is
missed; 2: a benchmark failed.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from time import monotonic

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.origin import RESULTS, ROOT, is_current

PLAN = (
    *("measured", "diagnosis", "attribution", "changes", "check", "loop", "peers", "plsr"),
    *("store", "identification", "monitoring", "pipelines", "servo", "six_joints", "others"),
)
FAILED = 2
_ENDS = {0: "no bar is missed", 1: "a bar is missed"}
_EVERY = 20.0  # s between two lines of progress


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a part of each")
    parser.add_argument("--only", nargs="+", choices=PLAN, default=PLAN)
    args = parser.parse_args()
    codes, start = [0], monotonic()
    for number, name in enumerate(args.only, start=1):
        label = f"[{number}/{len(args.only)}] {name}"
        if not args.quick and is_finished(name):
            print(f"{label}: finished before with the present code", flush=True)
        else:
            codes.append(_run(name, label, args.quick))
    print(f"\n{(monotonic() - start) / 60:.1f} min", flush=True)
    if not args.quick:
        missed = [
            f"{name}.{key}"
            for name in args.only
            for key, entry in read(name).get("figures", {}).items()
            if entry["ok"] is False
        ]
        print(f"{len(missed)} bars missed: {', '.join(missed)}")
        codes.append(int(bool(missed)))
        subprocess.run([sys.executable, "benchmarks/page.py"], cwd=ROOT, check=True)
    return max(codes)


def read(name: str) -> dict:
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def is_finished(name: str) -> bool:
    """Whether there is a result of a whole run of the present code."""
    content = read(name)
    whole = bool(content) and content["whole"] and not content["quick"]
    return whole and is_current(name, content)


def _run(name: str, label: str, quick: bool) -> int:
    """Run one benchmark and return its exit code; write its output to a log."""
    command = [sys.executable, "benchmarks/run.py", name]
    command += ["--quick"] if quick else ["--full-json", str(RESULTS / f"{name}.json")]
    log = ROOT / "store" / "benchmarks" / f"{name}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    start, last, line = monotonic(), monotonic(), ""
    print(f"{label} ...", flush=True)
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with (
        log.open("w", encoding="utf-8") as file,
        subprocess.Popen(command, cwd=ROOT, **both) as child,
    ):
        for line in child.stdout:
            file.write(line)
            file.flush()
            if monotonic() - last > _EVERY and line.startswith("["):
                last = monotonic()
                minutes = (last - start) / 60
                print(f"{label} {minutes:5.1f} min  {line.strip()[:100]}", flush=True)
    # Python ends with 1 of a crash, too: without figures nothing was measured.
    code = child.returncode if line.startswith("{") else FAILED
    failed = f"failed (code {code}): see {log.relative_to(ROOT)}"
    minutes = (monotonic() - start) / 60
    print(f"{label}: {minutes:.1f} min, {_ENDS.get(code, failed)}", flush=True)
    return code if code in _ENDS else FAILED


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print("\nstopped; finished cases are kept: repeat the command to continue")
        sys.exit(130)
