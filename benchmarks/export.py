"""Is a model in another program the same model, and what does that program lack of it?

    python benchmarks/export.py --quick         under 50 s on two cores
    python benchmarks/export.py --full-json OUT     benchmarks/results/...

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

GROUPS = {
    "targets": "export_parts.models:target_figures",
    "mujoco": "export_parts.loops:mujoco_figures",
    "bodies": "export_parts.bodies:body_figures",
    "callback": "export_parts.loops:loop_figures",
    "speed": "export_parts.models:speed_figures",
}


if __name__ == "__main__":
    sys.exit(run_groups(__doc__, GROUPS))
