"""Is the plant exact, sound in its books, fast, stable, always the same; well excited?

    python benchmarks/plant.py --quick                     under 50 s on two cores
    python benchmarks/plant.py --full-json benchmarks/results/plant.json

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

GROUPS = {
    "identity": "plant_parts.physics:identity_figures",
    "energy": "plant_parts.physics:energy_figures",
    "stability": "plant_parts.physics:stability_figures",
    "determinism": "plant_parts.physics:determinism_figures",
    "speed": "plant_parts.physics:speed_figures",
    "excitation": "plant_parts.physics:excitation_figures",
}


if __name__ == "__main__":
    sys.exit(run_groups(__doc__, GROUPS))
