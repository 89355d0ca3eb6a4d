"""Every benchmark that decides, one after another, on one commit.

    make bench                all of them: at most three hours on two cores
    make bench QUICK=1        a part of each, about ten minutes; decides nothing
    python benchmarks/bench.py --only measured diagnosis

Each writes its file in benchmarks/results, which says commit, hash of the code, seeds,
machine and day. A file whose code is the code as it is now is not made again, and an
interrupted benchmark goes on where it was (store/benchmarks): after Ctrl-C say the same
once more. What is measured at the end goes into the pages and the README
(benchmarks/page.py). A quick run writes no result. The seeds are in the benchmarks, are
used for nothing else, and were drawn before anyone had run them. Exit code 1 for a bar
that was missed, 2 for a benchmark that did not come to its end.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from time import monotonic

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.origin import RESULTS, ROOT, is_current

# What users ask first comes first: a run that is cut off has that.
PLAN: Mapping[str, tuple[str, ...]] = {
    "measured": ("benchmarks/measured.py",),
    "added": ("benchmarks/measured.py", "--added"),
    "diagnosis": ("benchmarks/diagnosis.py",),
    "attribution": ("benchmarks/attribution.py",),
    "changes": ("benchmarks/changes.py",),
    "check": ("benchmarks/check.py",),
    "loop": ("benchmarks/loop.py", "--resume"),
    "peers": ("benchmarks/peers.py",),
    "plsr": ("benchmarks/plsr.py", "--resume"),
    "identification": ("benchmarks/groups.py", "identification", "--resume"),
    "hardening": ("benchmarks/groups.py", "hardening", "--resume"),
    "store": ("benchmarks/store.py", "--resume"),
    "fleet": ("benchmarks/groups.py", "fleet", "--resume"),
    "pipelines": ("benchmarks/groups.py", "pipelines", "--resume"),
    "plant": ("benchmarks/groups.py", "plant", "--resume"),
}
LOGS = ROOT / "store" / "benchmarks" / "logs"
FAILED = 2
_SAID_EVERY = 20.0  # s between two lines of progress


def main() -> int:
    args = _arguments()
    LOGS.mkdir(parents=True, exist_ok=True)
    codes, begun = [], monotonic()
    wanted = [name for name in PLAN if name in args.only]
    for place, name in enumerate(wanted, start=1):
        where = f"[{place}/{len(wanted)}] {name}"
        if not args.quick and is_whole(name):
            print(f"{where}: known, of this very code", flush=True)
            continue
        codes.append(_run(name, where, args.quick))
    print(f"\n{(monotonic() - begun) / 60:.1f} min", flush=True)
    if args.quick:
        return max(codes, default=0)
    _show(wanted)
    subprocess.run([sys.executable, "benchmarks/page.py"], cwd=ROOT, check=True)
    return max([*codes, int(any(missed(name) for name in wanted))], default=0)


def is_whole(name: str) -> bool:
    """Whether a benchmark has a whole run of the code as it is."""
    content = _read(name)
    runs = content.get("by_group", {"": content})
    partial = content.get("quick", True) or not content.get("whole", True)
    return not partial and all(is_current(name, run) for run in runs.values())


def missed(name: str) -> list[str]:
    """Return the figures of a benchmark that missed their bars."""
    figures = _read(name).get("figures", {})
    return [key for key, entry in figures.items() if entry["ok"] is False]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a part of each")
    parser.add_argument("--only", nargs="+", choices=PLAN, default=tuple(PLAN))
    return parser.parse_args()


def _run(name: str, where: str, quick: bool) -> int:
    """Run one benchmark and return its exit code; its words go into a file."""
    command = [sys.executable, *PLAN[name]]
    if quick:
        command = [word for word in command if word != "--resume"] + ["--quick"]
    else:
        command += ["--full-json", str(RESULTS / f"{name}.json")]
    log, begun = LOGS / f"{name}.log", monotonic()
    print(f"{where} ...", flush=True)
    with log.open("w", encoding="utf-8") as file:
        # One stream for both, so that a traceback stands where it happened.
        child = subprocess.Popen(
            command,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for line in _said(child, file):
            minutes = (monotonic() - begun) / 60
            print(f"{where} {minutes:5.1f} min  {line[:100]}", flush=True)
        code = child.wait()
    took = f"{(monotonic() - begun) / 60:.1f} min"
    words = {0: "every bar met or not decided", 1: "a bar is missed"}
    end = f"did not come to its end (code {code}): see {log.relative_to(ROOT)}"
    print(f"{where}: {took}, {words.get(code, end)}", flush=True)
    return code if code in words else FAILED


def _said(child: subprocess.Popen, file) -> Iterator[str]:
    """Write what a benchmark says, and yield a line of it now and then."""
    last = monotonic()
    for line in child.stdout:
        file.write(line)
        file.flush()
        if monotonic() - last > _SAID_EVERY and line.startswith("["):
            last = monotonic()
            yield line.rstrip()


def _show(names: Sequence[str]) -> None:
    print(f"\n{'benchmark':15} {'commit':8} {'met':>4} {'missed':>6}  missed bars")
    for name in names:
        content = _read(name)
        if not content:
            print(f"{name:15} no result")
            continue
        oks = [entry["ok"] for entry in content["figures"].values()]
        commit = (content["commit"] or "")[:7]
        bad = ", ".join(missed(name))
        print(
            f"{name:15} {commit:8} {oks.count(True):4} {oks.count(False):6}  {bad}",
            flush=True,
        )


def _read(name: str) -> dict:
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print("\nstopped; what is finished is kept: say the same again to go on")
        sys.exit(130)
