"""Results that outlive an interruption, one JSON line per case."""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.figures import ROOT, code_hash
from flows.blind import draw as blind_draw
from flows.storage.null import method_hash

_HERE = Path(__file__).parent
_PLAN = tuple(_HERE / name for name in ("arms.py", "cases.py", "measured.py"))


class Kept:
    """A file with one line per finished case; a context manager.

    Args:
        path: The file; None for one in store/benchmarks that belongs to this code.
        words: From a row to what is printed of it; None for rows of one or two names.
    """

    def __init__(
        self, path: Path | None = None, words: Callable[[Mapping], str] | None = None
    ) -> None:
        self._say = words or _words
        name = f"diagnosis-{code_hash()}-{_plan_hash()}.jsonl"
        self._path = path or ROOT / "store" / "benchmarks" / name
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._known: dict[str, dict] = {}

    def __enter__(self) -> "Kept":
        if self._path.exists():
            for line in self._path.read_text(encoding="utf-8").splitlines():
                try:
                    self._known.update(json.loads(line))
                except ValueError:
                    continue  # the line that an interruption cut off
        self._file = self._path.open("a", encoding="utf-8")
        # A line of its own for what comes now, whatever the last one looks like.
        self._file.write("\n" if self._path.stat().st_size else "")
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __contains__(self, name: str) -> bool:
        """Whether a case is finished."""
        return name in self._known

    def run(
        self, pool: Any, work: Callable[[Any], dict], jobs: Mapping[str, Any]
    ) -> dict[str, dict]:
        """Do what is not known yet; return the results of all, by name."""
        todo = [name for name in jobs if name not in self._known]
        if len(todo) < len(jobs):
            print(f"{len(jobs) - len(todo)} of {len(jobs)} known already", flush=True)
        done = pool.run(work, [jobs[name] for name in todo])
        for count, one in enumerate(done, start=1):
            name, value = todo[one.index], one.value
            if one.error is not None:
                value = {"error": str(one.error)}
            self._known[name] = json.loads(json.dumps(value))
            # A process that died may live another day: only results are kept.
            if one.error is None:
                self._file.write(json.dumps({name: value}) + "\n")
                self._file.flush()
            print(
                f"[{count}/{len(todo)}] {name}: {_crash(value) or self._say(value)}",
                flush=True,
            )
        return {name: self._known[name] for name in jobs}


def _plan_hash() -> str:
    """Return the hash of what draws and judges, which the common one leaves out."""
    total = hashlib.sha256(method_hash().encode())
    for path in (*_PLAN, Path(blind_draw.__file__)):
        total.update(path.read_bytes())
    return total.hexdigest()[:8]


def _crash(row: Mapping) -> str:
    return f"crash: {row['error']}" if "error" in row else ""


def _words(row: Mapping) -> str:
    if "outcome" not in row:
        return "done"
    names = "; ".join(f"{n[0]} {n[1]}" for n in row["names"]) or "nothing"
    hidden = f"{row['effect']} {row['joints']}"
    if row["second_effect"]:
        hidden += f" + {row['second_effect']} {row['second_joints']}"
    return f"{row['outcome']}: {hidden} -> {names} ({row['seconds']} s)"
