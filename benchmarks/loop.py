"""Does one designed experiment settle what a first verdict left open, and how soon?

    python benchmarks/loop.py --seeds 1:4       to look at; minutes for each case
    python benchmarks/loop.py --full-json benchmarks/results/loop.json

Seeds 166601:166608 decide and are used for nothing else; 1 to 99 are for development. A
case takes minutes, so that a quick run measures nothing.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.cases import run_cases
from benchmarks.loop_parts import next as part

if __name__ == "__main__":
    code = run_cases(
        __doc__,
        "166601:166608",
        ["next"],
        ["benchmarks/loop_parts", "flows/steps/next.py"],
        part.jobs,
        part.run,
        part.summary,
        part.all_figures,
    )
    sys.exit(code)
