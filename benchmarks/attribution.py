"""Is the whole set of changed values named, and nothing else?

    python benchmarks/attribution.py --quick                     under 50 s on two cores
    python benchmarks/attribution.py --seeds 1:2 --groups sets      to look at
    python benchmarks/attribution.py --full-json benchmarks/results/attribution.json

Arms of six and of seven joints whose given inertias, friction and rotors are exact or 1
or 3 % off. `unchanged`: nothing else is off, and any name is false. `sets`: a load,
links 8 to 25 % off and friction, each of 2 % of a joint's torque or more. Seeds
166201:166208 decide and are used for nothing else; 1 to 99 are for development.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.attribution_parts import bars, cases
from benchmarks.harness.cases import run_cases

if __name__ == "__main__":
    code = run_cases(
        __doc__,
        "166201:166208",
        cases.GROUPS,
        ["benchmarks/attribution_parts"],
        cases.jobs,
        cases.run,
        cases.summary,
        bars.all_figures,
    )
    sys.exit(code)
