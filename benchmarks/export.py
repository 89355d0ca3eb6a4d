"""Is a model in another program the same model, and what does that program lack of it?

    python benchmarks/export.py --quick         under 50 s on two cores
    python benchmarks/export.py --full-json OUT     benchmarks/results/...

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import Figures
from benchmarks.groups import run_groups

_GROUPS = ("targets", "mujoco", "speed")


def main() -> int:
    """Run the groups and return the exit code."""
    return run_groups(__doc__, _GROUPS, _measure)


def _measure(name: str, quick: bool) -> Figures:
    from benchmarks.export_parts import mujoco_loop, speed, targets

    if name == "targets":
        return targets.target_figures(quick)
    if name == "mujoco":
        return mujoco_loop.mujoco_figures(quick)
    return speed.speed_figures()


if __name__ == "__main__":
    sys.exit(main())
