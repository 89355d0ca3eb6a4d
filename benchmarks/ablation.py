"""What does each doubt of a name prevent, and what does it cost?

    python benchmarks/ablation.py --seeds 1:1               to look at
    python benchmarks/ablation.py --full-json benchmarks/results/ablation.json

Every rule by which a name may fall is switched off in turn, on the same cases, drawn
before any rule is asked: simulated arms, clean and in use, with a change, with one that
has no name, and without; logs of measured arms as they are, and with a change added.
Nothing of before is given. A name on a joint is true if it was planted there (or says
that it cannot be told from that), or if such an arm has it anyway; else it is false. A
false one weighs five that are missed. The search is done once for all rules. Seeds
90301:90301 decide; 1 to 99 are for development. The last line is one JSON object.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.changes_parts import cases
from benchmarks.changes_parts.case import CHANGE, REAL_CHANGE, UNCHANGED, UNNAMED
from benchmarks.harness.cases import read_options, save_rows, seed_range, seeded_options
from benchmarks.harness.figures import Figures, figure, finish, one_blas_thread
from benchmarks.measured_parts import rules
from benchmarks.measured_parts.arms import SPLITS, data_folder
from flows.workers.pool import Pool

SEEDS = "90301:90301"
GROUPS = (CHANGE, UNCHANGED, UNNAMED, REAL_CHANGE, rules.SPLIT)
LEAST = 0.07  # size of a change from which on it is asked for
WEIGHT = 5  # names missed that one false name is worth


def main() -> int:
    """Run the cases and return the exit code."""
    args = read_options(seeded_options(__doc__, SEEDS, GROUPS), "1:1")
    one_blas_thread()
    with Pool(2) as pool:
        jobs = _jobs(args.groups, seed_range(args.seeds))
        rows: list[dict] = []
        for done in pool.run(rules.ask, jobs):
            if done.error:
                print(f"{jobs[done.index].name}: {done.error}", flush=True)
                continue
            rows += done.value
            print(f"[{done.index + 1}/{len(jobs)}] {jobs[done.index].name}", flush=True)
    figures = figures_of(rows)
    save_rows(args, figures, rows=rows)
    return finish(figures)


def _jobs(groups: Sequence[str], seeds: Sequence[int]) -> list[rules.Job]:
    """Return the cases of all groups, in an order that knows no rule."""
    out = []
    for group in groups:
        if group == rules.SPLIT:
            names = SPLITS if data_folder() else {}
            out += [rules.Job(split=n) for n, s in names.items() if not s.baseline]
            continue
        drawn = cases.listed(group, seeds, committed=False)
        out += [rules.Job(case=c) for c in drawn if not c.target or c.target > LEAST]
    return out


def figures_of(rows: Sequence[dict]) -> Figures:
    """Return for every rule what its absence gains and costs."""
    out: Figures = {}
    base = _sums([r for r in rows if r["rule"] == rules.NONE])
    for rule in rules.RULES:
        own = _sums([r for r in rows if r["rule"] == rule])
        prevented, cost = own["false"] - base["false"], own["true"] - base["true"]
        out[f"rule_{rule}"] = figure(
            WEIGHT * prevented - cost,
            None,
            own["cases"],
            prevented=prevented,
            cost=cost,
            planted=own["planted"] - base["planted"],
            why=f"prevents {prevented} false names of joints, costs {cost} true ones",
        )
    return out | {
        "names_true": figure(base["true"], None, base["cases"]),
        "names_false": figure(base["false"], None, base["cases"]),
    }


def _sums(rows: Sequence[dict]) -> dict[str, int]:
    keys = ("true", "false", "planted")
    return {"cases": len(rows)} | {k: sum(r[k] for r in rows) for k in keys}


if __name__ == "__main__":
    sys.exit(main())
