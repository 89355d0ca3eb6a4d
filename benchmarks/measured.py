"""Logs and robot files of other people: our models beside peers and weighed loads.

    python benchmarks/measured.py --groups splits      after a change of the method
    python benchmarks/measured.py --quick              four splits, two packages
    python benchmarks/measured.py --full-json benchmarks/results/measured.json

`splits`: measured arms, fitted and held out; beside ours plain least squares of all
inertial parameters, friction and constants, and the paper's PLSR. `added`: the same
logs with a known effect added, of those that an oracle hears the first names against
other new ones, beside a greedy selection; `--seeds 820:820 --groups added` on other
draws. `files`: robot files of installed packages.
"""

import sys
from collections.abc import Mapping, Sequence
from itertools import permutations
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.harness.cases import (
    kept_file,
    read_options,
    run_kept,
    save_rows,
    seed_range,
)
from benchmarks.harness.figures import NO_BAR, NO_LOGS, Figures, figure, finish, missing
from benchmarks.harness.rates import at_least, at_most, share
from benchmarks.measured_parts import added, arms, bars, files

_SEEDS = "155701:155701"  # of the added effects
WORSE = 1.10  # times plain least squares on one joint: more than a log decides
REPEATED, CONSTANT = 0.7, "offset"
LOADED_JOINTS, DAYS_NAMED, HALVED = (2, 3), 4, 0.7
FRICTION = "load_friction"
WEIGHED, LOAD_ERROR = 2.805, 0.08  # kg; share
QUICK = ("ur10 60 % | 40 %", "kr300 AB | C", "ur10e feb10 | other days", arms.LOADED)


def main() -> int:
    args = read_options(__doc__, _SEEDS, ("splits", "added", "files"))
    parts = ("benchmarks/measured_parts", "benchmarks/changes_parts")
    path = kept_file("measured", *parts)
    figures: Figures = {}
    rows: dict[str, list] = {}
    tables = []
    if "splits" in args.groups:
        names = [n for n in (QUICK if args.quick else arms.SPLITS) if not _absent(n)]
        done = run_kept(
            path,
            _summary,
            arms.measure,
            {n: n for n in names},
            processes=args.processes,
        )
        rows["splits"] = _finished(done)
        figures |= split_figures(rows["splits"])
        tables.append(table(rows["splits"]))
    if "added" in args.groups and not args.quick:
        every = [c for seed in seed_range(args.seeds) for c in added.cases(seed)]
        jobs = {case.name: case for case in every if not _absent(case.split)}
        rows["added"] = _finished(
            run_kept(path, added.summary, added.measure, jobs, processes=args.processes)
        )
        figures |= bars.added_figures(rows["added"]) if rows["added"] else {}
        tables += [bars.curve(rows["added"])] if rows["added"] else []
    if "files" in args.groups:
        figures |= files.figures(args.quick)
    save_rows(args, figures, **rows, tables=tables)
    for each in tables:
        head, *lines = each["rows"]
        shown = Table(*head, title=each["title"], box=None)
        for line in lines:
            shown.add_row(*line)
        Console(width=150).print(shown)
    return finish(figures)


def _absent(split: str) -> bool:
    return arms.absent(arms.SPLITS[split].arm)


def _finished(done: Mapping[str, dict]) -> list[dict]:
    failed = [f"{k}: {row['error']}" for k, row in done.items() if "error" in row]
    if failed:
        raise SystemExit("; ".join(failed))
    return list(done.values())


def split_figures(rows: Sequence[Mapping]) -> Figures:
    """Return the figures of diagnosed splits; null without measured logs."""
    if not rows:
        return {"measured_worse_than_least_squares": missing(0, NO_LOGS)}
    by_name = {row["split"]: row for row in rows}
    held = {row["split"]: _over(row, "peer") for row in rows if row["peer"]}
    ratios = np.concatenate([*held.values()] or [[]])
    paper = np.concatenate([_over(row, "plsr") for row in rows if row["peer"]] or [[]])
    worse = {k: (1 + np.flatnonzero(v > WORSE)).tolist() for k, v in held.items()}
    out = {
        "measured_worse_than_least_squares": _where(worse, len(ratios)),
        "measured_over_least_squares": _mean(ratios),
        "measured_over_plsr": _mean(paper),
        "measured_joints_harmed": _where(
            {row["split"]: row["worse"] for row in rows}, len(ratios)
        ),
    }
    return out | _repeats(rows) | _friction(by_name) | _load(by_name)


def _over(row: Mapping, peer: str) -> np.ndarray:
    """Error of the augmented model over a peer's; NaN where a torque is too small."""
    return np.array(row["filtered"]["augmented"], dtype=float) / row[peer]


def _mean(ratios: np.ndarray) -> dict:
    good = ratios[np.isfinite(ratios)]
    value = float(np.exp(np.log(good).mean())) if len(good) else None
    return figure(value, None, len(good), why=NO_BAR)


def _where(joints: Mapping[str, Sequence[int]], n: int) -> dict:
    some = {name: of_split for name, of_split in joints.items() if of_split}
    return figure(sum(map(len, some.values())), 0, n, where=some)


def _repeats(rows: Sequence[Mapping]) -> Figures:
    """Return how many names of one split another split of the same logs has too.

    A name is an effect on one joint. It repeats as itself, or if one of the two states
    the other as an equivalent. All pairs of splits of one arm and torque count.
    """
    names = [
        (name, [_is_twin(name, other) for other in _places(b)])
        for a, b in permutations(rows, 2)
        if arms.same_logs(a["split"], b["split"])
        for name in _places(a)
    ]
    every = [any(twins) for _, twins in names]
    some = [any(twins) for name, twins in names if name[0] != CONSTANT]
    return {
        "names_repeat": at_least(share(sum(every), len(every)), REPEATED),
        "names_repeat_no_constants": at_least(share(sum(some), len(some)), None),
    }


def _places(row: Mapping) -> list[tuple[str, int, tuple[str, ...]]]:
    """Return effect, joint (0 for the whole arm) and its equivalents there."""
    return [
        (name, j, tuple(a for a, on in alike if j in (*on, 0)))
        for (name, joints), alike in zip(row["named"], row["alike"], strict=True)
        for j in joints or (0,)
    ]


def _is_twin(one: Sequence, other: Sequence) -> bool:
    same = {one[0], *one[2]} & {other[0], *other[2]}
    return one[1] == other[1] and bool({one[0], other[0]} & same)


def _friction(by_name: Mapping[str, Mapping]) -> Figures:
    """Return figures of friction that grows with load, on the UR10e."""
    days = [
        by_name[n] for d in arms.DAYS if (n := f"ur10e {d} | other days") in by_name
    ]
    named = [row for row in days if all(_has_friction(row, j) for j in LOADED_JOINTS)]
    if not days:
        return {}
    ratios = [
        row["moving"]["augmented"][j - 1] / row["moving"]["identified"][j - 1]
        for row in named
        for j in LOADED_JOINTS
    ]
    bar = DAYS_NAMED if len(days) == len(arms.DAYS) else len(days)
    ok = len(named) >= bar
    return {
        "ur10e_days_named": figure(len(named), bar, len(days), ok=ok, at_least=True),
        "ur10e_error_over_refit": figure(
            max(ratios, default=None), HALVED, len(ratios)
        ),
    }


def _has_friction(row: Mapping, joint: int) -> bool:
    pairs = zip(row["named"], row["alike"], strict=True)
    return any(
        FRICTION in (name[0], *(a[0] for a in alike)) and joint in name[1]
        for name, alike in pairs
    )


def _load(by_name: Mapping[str, Mapping]) -> Figures:
    """Return mass of the weighed load, its error, and what is named without it."""
    row, days = by_name.get(arms.LOADED), [f"ur10e {d} | other days" for d in arms.DAYS]
    if row is None:
        return {}
    mass = row["mass"][0] if row["mass"] else None
    error = None if mass is None else abs(mass / WEIGHED - 1)
    alone = mass is not None and len(row["named"]) == 1
    entry = at_most(figure(error, None, 1, mass=mass, alone=alone), LOAD_ERROR)
    unloaded = [by_name[d] for d in days if d in by_name]
    false = sum(bool(each["mass"]) for each in unloaded)
    return {
        "ur10e_load_error": entry if alone else entry | {"ok": False},
        "ur10e_load_without_one": figure(false, 0, len(unloaded)),
    }


def table(rows: Sequence[Mapping]) -> dict:
    """Return held-out errors per joint of all models: title and rows of texts."""
    lines = [["fitted / held out", "named", "ours [%]", "least squares", "PLSR"]]
    for row in rows:
        named = "; ".join(f"{n} {','.join(map(str, js))}" for n, js in row["named"])
        errors = (row["filtered"].get("augmented"), row["peer"], row["plsr"])
        cells = [", ".join(_percent(x) for x in each or ()) or "–" for each in errors]
        split = row["split"].replace("|", "/")
        lines.append([split, named.strip() or row["verdict"], *cells])
    return {"title": "Held-out error by joint", "rows": lines}


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


def _summary(row: Mapping) -> str:
    named = ", ".join(f"{name} {joints}" for name, joints in row["named"])
    return f"{named or row['verdict']} ({row['seconds']} s)"


if __name__ == "__main__":
    sys.exit(main())
