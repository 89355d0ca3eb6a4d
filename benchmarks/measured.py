"""Measured arms: what is named on them, and is it better than plain least squares?

    python benchmarks/measured.py                      a minute or two; to be run at
                                                       every change of the method
    python benchmarks/measured.py --added              effects added, half an hour
    python benchmarks/measured.py --against OLD.json   before and after in one table
    python benchmarks/measured.py --full-json benchmarks/results/measured.json

Nobody knows the whole truth of a real arm. What is known of these is held up: a load
that was weighed, friction that grows with load on two joints of the UR10e, errors that
an earlier version reached, and plain least squares of all inertial parameters with
Coulomb and viscous friction and a constant, which no diagnosis may be worse than. The
last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import Figures, figure, finish, missing, one_blas_thread
from benchmarks.harness.origin import circumstances, save
from benchmarks.measured_parts import arms, known
from flows.workers.processes import Processes, spread

# Filtered held-out errors that were reached before [%], and what a change may add.
REACHED = {
    "ur10 60 % | 40 %": (8.4, 2.7, 4.2, 6.0, 8.6, 25.3),
    "kr300 AB | C": (7.7, 12.8, 6.4, 19.1, 11.2, 14.8),
}
SPARE = 1.05
WORSE = 1.10  # times plain least squares on one joint: beyond what a log decides
REPEATED, CONSTANT = 0.7, "offset"
LOADED_JOINTS, DAYS_NAMED, HALVED = (2, 3), 4, 0.7
FRICTION = "load_friction"
LOAD = (2.7, 3.1)  # kg; 2.805 were weighed, the drives' gains may carry the rest
_MODELS = ("identified", "augmented")
QUICK = ("ur10 60 % | 40 %", "kr300 AB | C", "ur10e feb10 | other days", arms.LOADED)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="four splits")
    parser.add_argument("--added", action="store_true", help="known effects, no splits")
    parser.add_argument(
        "--against", type=Path, metavar="FILE", help="results of before"
    )
    parser.add_argument("--full-json", type=Path, metavar="FILE")
    args = parser.parse_args()
    one_blas_thread()
    if args.added:
        return _added(args.full_json, args.quick)
    rows = _rows(arms.measure, QUICK if args.quick else tuple(arms.SPLITS))
    before = _read(args.against)
    for row in rows:
        _show(row, before.get(row["split"]))
    figures = figures_of(rows)
    if args.full_json:
        whole = not args.quick
        facts = circumstances(args.full_json.stem, quick=args.quick, whole=whole)
        save(args.full_json, {**facts, "figures": figures, "measured": rows})
    return finish(figures)


def _added(results: Path | None, quick: bool) -> int:
    """Diagnose logs with a known effect added, and those without beside them."""
    splits = known.SPLITS[:1] if quick else known.SPLITS
    cases = [c for c in known.cases(known.DECIDING) if c.split in splits]
    names = [*splits, *(case.name for case in cases)]
    rows = _rows(known.measure, names)
    figures = known.figures(rows)
    if results:
        facts = circumstances(results.stem, quick=quick, whole=not quick)
        save(results, {**facts, "figures": figures, "added": rows})
    return finish(figures)


def _rows(measure: Callable[[str], dict], names: Sequence[str]) -> list[dict]:
    if arms.data_folder() is None:
        return []
    with Processes(2) as pool:
        done = {d.index: d for d in spread(pool, measure, names)}
    failed = [f"{names[i]}: {d.error}" for i, d in done.items() if d.error]
    if failed:
        raise SystemExit("; ".join(failed))
    return [done[i].value for i in range(len(names))]


def figures_of(rows: Sequence[Mapping]) -> Figures:
    """Return the figures of diagnosed splits; null where the logs are not there."""
    if not rows:
        why = "no measured logs: neither ../shared/data nor $MODELGAP_DATA"
        return {"measured_worse_than_least_squares": missing(0, why)}
    by_name = {row["split"]: row for row in rows}
    held = [row for row in rows if row["peer"] is not None]
    ratios = np.concatenate([_ratio(row) for row in held])
    worse = {
        row["split"]: (1 + np.flatnonzero(_ratio(row) > WORSE)).tolist() for row in held
    }
    harmed = {row["split"]: row["worse"] for row in rows}
    out = {
        "measured_worse_than_least_squares": _where(worse, len(ratios)),
        "measured_over_least_squares": figure(
            float(np.exp(np.nanmean(np.log(ratios)))),
            None,
            int(np.isfinite(ratios).sum()),
            why="geometric mean, for information",
        ),
        "measured_joints_harmed": _where(harmed, len(ratios)),
    }
    for name, reached in REACHED.items():
        if name in by_name:
            worst = arms.over(by_name[name]["filtered"]["augmented"], reached).max()
            key = f"measured_{name.split(' ')[0]}_over_reached"
            out[key] = figure(round(float(worst), 4), SPARE, len(reached))
    return out | _repeats(rows) | _friction(by_name) | _load(by_name)


def _repeats(rows: Sequence[Mapping]) -> Figures:
    """Names of one split of an arm's logs that another split of them has too.

    A name is an effect on one joint; it comes back as itself, or where one of the two
    is said to be like the other. Every two splits of one arm and torque count, both
    ways; also without constants.
    """
    alike = [(a, b) for a in rows for b in rows if a is not b and _same_arm(a, b)]
    names = [(one, b) for a, b in alike for one in _places(a)]
    some = [(one, b) for one, b in names if one[0] != CONSTANT]
    out = {}
    for key, own in (("names_repeat", names), ("names_repeat_no_constants", some)):
        hits = [any(_is_twin(one, other) for other in _places(b)) for one, b in own]
        value = float(np.mean(hits)) if hits else None
        ok = None if value is None else value >= REPEATED
        bar = REPEATED if key == "names_repeat" else None
        out[key] = figure(value, bar, len(hits), ok=ok if bar else None, at_least=True)
    return out


def _same_arm(a: Mapping, b: Mapping) -> bool:
    heads = [row["split"].split(" | ")[0].split() for row in (a, b)]
    first = [
        head[:2] if head[1] in ("run", "motor", "run_nm") else head[:1]
        for head in heads
    ]
    return first[0] == first[1] and arms.LOADED not in (a["split"], b["split"])


def _places(row: Mapping) -> list[tuple[str, int, tuple[str, ...]]]:
    """Effect, joint (0 for the whole arm) and what it is like there."""
    return [
        (name, j, tuple(a for a, on in alike if j in (*on, 0)))
        for (name, joints), alike in zip(row["named"], row["alike"], strict=True)
        for j in joints or (0,)
    ]


def _is_twin(one: Sequence, other: Sequence) -> bool:
    same = {one[0], *one[2]} & {other[0], *other[2]}
    return one[1] == other[1] and bool({one[0], other[0]} & same)


def _where(joints: Mapping[str, Sequence[int]], n: int) -> dict:
    some = {name: own for name, own in joints.items() if own}
    return figure(sum(map(len, some.values())), 0, n, where=some)


def _friction(by_name: Mapping[str, Mapping]) -> Figures:
    """Friction that grows with load, on the UR10e: is it named, and what is left."""
    days = [
        by_name[n] for d in arms.DAYS if (n := f"ur10e {d} | other days") in by_name
    ]
    named = [row for row in days if all(_names(row, j) for j in LOADED_JOINTS)]
    if not days:
        return {}
    left = [
        row["moving"]["augmented"][j - 1] / row["moving"]["identified"][j - 1]
        for row in named
        for j in LOADED_JOINTS
    ]
    bar = DAYS_NAMED if len(days) == len(arms.DAYS) else len(days)
    ok = len(named) >= bar
    return {
        "ur10e_days_named": figure(len(named), bar, len(days), ok=ok, at_least=True),
        "ur10e_error_over_refit": figure(max(left, default=None), HALVED, len(left)),
    }


def _names(row: Mapping, joint: int) -> bool:
    """Whether friction that grows with load is named there, or a class with it."""
    pairs = zip(row["named"], row["alike"], strict=True)
    return any(
        FRICTION in (name[0], *(a[0] for a in alike)) and joint in name[1]
        for name, alike in pairs
    )


def _load(by_name: Mapping[str, Mapping]) -> Figures:
    row = by_name.get(arms.LOADED)
    if row is None:
        return {}
    mass = row["mass"][0] if row["mass"] else None
    ok = mass is not None and LOAD[0] <= mass <= LOAD[1] and len(row["named"]) == 1
    return {"ur10e_load": figure(mass, None, 1, ok=ok, why="2.7 to 3.1 kg, and alone")}


def _ratio(row: Mapping) -> np.ndarray:
    return arms.over(row["filtered"]["augmented"], row["peer"])


def _show(row: Mapping, before: Mapping | None) -> None:
    """Print one split: what is named, and errors per joint."""
    named = ", ".join(f"{name} {joints}" for name, joints in row["named"])
    print(f"\n{row['split']}: {named or row['verdict']} ({row['seconds']} s)")
    if before:
        was = ", ".join(f"{name} {joints}" for name, joints in before["named"])
        print(f"  before: {was or before['verdict']}")
    lines = [("least squares", row["peer"])]
    lines += [("before, filtered", before["filtered"]["augmented"])] if before else []
    lines += [(f"{m}, filtered", row["filtered"].get(m)) for m in _MODELS]
    lines += [(f"{m}, moving", row["moving"].get(m)) for m in _MODELS]
    for label, values in lines:
        if values:
            cells = "".join(f"{'-':>8}" if v is None else f"{v:8.1f}" for v in values)
            print(f"  {label:22}{cells}")
    for said in row["contradictions"]:
        print(f"  {said}")


def _read(path: Path | None) -> dict[str, Mapping]:
    if path is None:
        return {}
    rows = json.loads(path.read_text(encoding="utf-8"))["measured"]
    return {row["split"]: row for row in rows}


if __name__ == "__main__":
    sys.exit(main())
