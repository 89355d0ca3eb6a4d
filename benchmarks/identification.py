"""Is the identification exact, honest about its errors, consistent, and fast?

    python benchmarks/identification.py --quick         under 50 s on two cores
    python benchmarks/identification.py --full-json OUT     benchmarks/results/...

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import Figures
from benchmarks.groups import run_groups

_GROUPS = ("identities", "recovery", "measured", "speed")


def main() -> int:
    """Run the groups and return the exit code."""
    return run_groups(__doc__, _GROUPS, _measure)


def _measure(name: str, quick: bool) -> Figures:
    from benchmarks.identification_parts import identities, measured, recovery, speed

    if name == "identities":
        return identities.identity_figures()
    if name == "recovery":
        return recovery.recovery_figures(2 if quick else 20)
    if name == "measured":
        return measured.measured_figures(quick)
    return speed.speed_figures(2 if quick else 9)


if __name__ == "__main__":
    sys.exit(main())
