"""What changed between an earlier state of an arm and its new logs: is it found?

    python benchmarks/changes.py --quick                     a case of each group
    python benchmarks/changes.py --seeds 1:1 --groups change
    python benchmarks/changes.py --full-json benchmarks/results/changes.json

The size of a change is the RMS of its torque over that of the joint, not a multiple of
what the program says. Silence is a miss. Seeds 166301:166303 decide and are used for
nothing else; 1 to 99 are for development. The peer, a plain regression of both epochs,
gets the same cases in the same run.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.changes_parts import answers, bars, draw
from benchmarks.harness.cases import run_cases

if __name__ == "__main__":
    code = run_cases(
        __doc__,
        "166301:166303",
        draw.GROUPS,
        ["benchmarks/changes_parts", "benchmarks/check_parts"],
        draw.jobs,
        answers.run,
        answers.summary,
        bars.all_figures,
    )
    sys.exit(code)
