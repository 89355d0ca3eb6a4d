"""Benchmarks over drawn cases: NAME is attribution, changes, loop or peers.

    python benchmarks/drawn.py changes --quick                     a part, under 50 s
    python benchmarks/drawn.py attribution --seeds 1:2 --groups sets      to look at
    python benchmarks/drawn.py peers --full-json benchmarks/results/peers.json

attribution: is the whole set of changed values named, and nothing else? Given values of
arms of six and seven joints are exact or 1 or 3 % off; a change is 2 % of a joint's
torque or more.
changes: what changed between an earlier state of an arm and its new logs? Sizes are
shares of the torque of the joint; silence is a miss; a plain regression of both epochs
gets the same cases.
loop: does one designed experiment settle what a first verdict left open, and how soon?
A case takes minutes, so that a quick run measures nothing.
peers: other programs on the same hidden effects: least squares, and a sparse selection
written from the description of SAPC, not that program.

The seeds below decide and are used for nothing else; 1 to 99 are for development.
"""

import sys
from importlib import import_module
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.cases import run_cases

# Deciding seeds; the module that draws, runs and summarises cases; that of the figures.
DRAWN = {
    "attribution": ("166201:166208", "attribution_parts.cases", "attribution_parts.bars"),
    "changes": ("166304:166306", "changes_parts.answers", "changes_parts.bars"),
    "loop": ("166601:166608", "loop_parts.next", "loop_parts.next"),
    "peers": ("166501:166502", "peers_parts.cases", "peers_parts.bars"),
}
# What else draws or judges cases: a change makes kept rows worthless.
_ALSO = {"changes": ["benchmarks/check_parts"], "loop": ["flows/steps/next.py"]}


def main(name: str) -> int:
    seeds, *places = DRAWN[name]
    cases, bars = (import_module(f"benchmarks.{place}") for place in places)
    code = [f"benchmarks/{name}_parts", *_ALSO.get(name, ())]
    each = cases.jobs, cases.run, cases.summary, bars.all_figures
    return run_cases(__doc__, name, seeds, cases.GROUPS, code, *each)


if __name__ == "__main__":
    name = sys.argv.pop(1) if len(sys.argv) > 1 else ""
    if name not in DRAWN:
        raise SystemExit(f"{__doc__}\nFirst argument: one of {', '.join(DRAWN)}.")
    sys.exit(main(name))
