"""Is the plant exact, sound in its books, fast, stable, always the same; well excited?

    python benchmarks/plant.py --quick                     under 50 s on two cores
    python benchmarks/plant.py --full-json benchmarks/results/plant.json

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import Figures
from benchmarks.groups import run_groups

_GROUPS = ("identity", "energy", "stability", "determinism", "speed", "excitation")


def main() -> int:
    """Run the groups and return the exit code."""
    return run_groups(__doc__, _GROUPS, _measure)


def _measure(name: str, quick: bool) -> Figures:
    from benchmarks.plant_parts import excitation, identity, physics, speed

    if name == "identity":
        return identity.identity_figures(1 if quick else 5, quick)
    if name == "energy":
        families, seeds = (1, 1) if quick else (3, 3)
        return physics.energy_figures(families, seeds)
    if name == "stability":
        return physics.stability_figures(3.0 if quick else 10.0, quick)
    if name == "determinism":
        return physics.determinism_figures(3 if quick else 18)
    if name == "speed":
        return speed.speed_figures(3 if quick else 11)
    return excitation.excitation_figures(quick)


if __name__ == "__main__":
    sys.exit(main())
