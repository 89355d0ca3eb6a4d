"""Other programs on the same hidden effects: what does each name, and is it right?

    python benchmarks/peers.py --quick                          two short cases
    python benchmarks/peers.py --seeds 1:1 --groups squares sparse      to look at
    python benchmarks/peers.py --full-json benchmarks/results/peers.json

Each seed is ten cases in the physics engine, of the built-in arm for odd seeds, of a
drawn one for even ones; sizes are shares of the torque of a joint. The programs are
ours, plain least squares, and a sparse selection written from the description of SAPC,
not that program. Seeds 166501:166502 decide and are used for nothing else; 1 to 99 are
for development.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.cases import run_cases
from benchmarks.peers_parts import bars, cases

if __name__ == "__main__":
    code = run_cases(
        __doc__,
        "166501:166502",
        list(cases.PROGRAMS),
        ["benchmarks/peers_parts"],
        cases.jobs,
        cases.run,
        cases.summary,
        bars.all_figures,
    )
    sys.exit(code)
