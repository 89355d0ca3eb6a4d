"""Figures of a benchmark: value, bar, verdict; the table and the last line."""

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

Figures = dict[str, dict]

NO_BAR = "for information, no bar of its own"
FEW = "not the deciding draws; the full run decides"
NO_LOGS = "no measured logs: neither ../shared/data nor $MODELGAP_DATA"
CRASHES = "crashes"


def one_blas_thread() -> None:
    """Give every process started from here on one BLAS thread."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"


def figure(value: float | None, bar: float | None, n: int, **extra: object) -> dict:
    """Return a figure that must not exceed its bar.

    Args:
        value: What was measured, None if it was not.
        bar: What it may be at most, None where there is no bar.
        extra: Anything else to record; `ok` overrides the comparison, and a `why`
            explains an `ok` of None.
    """
    ok = None if value is None or bar is None else bool(value <= bar)
    return {"value": value, "bar": bar, "ok": ok, "n": n, **extra}


def missing(bar: float | None, why: str) -> dict:
    """Return a figure that this run cannot measure."""
    return figure(None, bar, 0, why=why)


def partial(entry: dict, why: str) -> dict:
    """Return the figure of a run that is too small to confirm it, only to refute."""
    return {**entry, "ok": False if entry["ok"] is False else None, "why": why}


def all_missing(bars: Mapping[str, float | None], why: str) -> Figures:
    """Return figures that this run cannot measure, from their bars."""
    return {name: missing(bar, why) for name, bar in bars.items()}


def all_partial(figures: Figures, why: str) -> Figures:
    """Return figures of a run that is too small to confirm any; "" where it is not."""
    return {k: partial(f, why) for k, f in figures.items()} if why else figures


def undecided(figures: Figures) -> Figures:
    """Return figures that no bar is for, crashes apart."""
    return {
        name: entry | {"ok": None, "why": entry.get("why") or FEW}
        if entry["bar"] is not None and name != CRASHES
        else entry
        for name, entry in figures.items()
    }


def show(figures: Figures) -> None:
    """Print the table of figures."""
    width = max(len(name) for name in figures)
    print(f"\n{'figure':{width}}  {'value':>9}  {'bar':>7}  {'n':>4}  result")
    for name, entry in figures.items():
        value, bar = (_number(entry[key]) for key in ("value", "bar"))
        result = {True: "ok", False: "MISSED", None: "-"}[entry["ok"]]
        why = f"  ({entry['why']})" if entry.get("why") else ""
        print(f"{name:{width}}  {value:>9}  {bar:>7}  {entry['n']:>4}  {result}{why}")


def finish(figures: Figures) -> int:
    """Print the table and the last line; return 1 if a bar is missed, else 0."""
    show(figures)
    print(json.dumps(figures), flush=True)
    return int(any(entry["ok"] is False for entry in figures.values()))


def code_hash(*own: str) -> str:
    """Return a hash over the code and the robots that decide results.

    Args:
        own: Folders of the benchmark; none for those of benchmarks/logs.py.
    """
    digest = hashlib.sha256()
    own = own or ("benchmarks/measured_parts",)
    for folder in ("residual", "sim", "warehouse/logs", *own):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".urdf", ".toml"):
                digest.update(str(path.relative_to(ROOT)).encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def circumstances(**extra: object) -> dict:
    """Return commit, code hash, date and machine of this run."""
    return {
        "commit": _git("rev-parse", "HEAD"),
        "dirty": bool(_git("status", "--porcelain")),
        "code_hash": code_hash(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        **extra,
    }


def save(path: Path, content: dict) -> None:
    """Write a result file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)


def _git(*words: str) -> str | None:
    done = subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() if done.returncode == 0 else None


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
