"""Benchmarks of single rooms, measured group by group.

    python benchmarks/groups.py monitoring --quick         a part, under 50 s
    python benchmarks/groups.py identification
    python benchmarks/groups.py servo --groups chain
    python benchmarks/groups.py servo_developed     the half to work on, not to report
    python benchmarks/groups.py pipelines --full-json OUT

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

# The groups of each benchmark, in order, and the functions that measure them.
GROUPS = {
    "identification": {"recovery": "identification_parts.recovery:recovery_figures"},
    "monitoring": {"sensors": "monitoring_parts.sensors:sensor_figures"},
    "servo": {
        "chain": "servo_parts.pendulum:chain_figures",
        "masses": "servo_parts.pendulum:mass_figures",
        "changes": "servo_parts.pendulum:change_figures",
        "position": "servo_parts.position:position_figures",
    },
    "six_joints": {"hidden": "servo_parts.six_joints:six_joint_figures"},
    "servo_developed": {"changes": "servo_parts.pendulum:developed_figures"},
    "pipelines": {"overhead": "pipelines_parts.overhead:overhead_figures"},
}


if __name__ == "__main__":
    name = sys.argv.pop(1) if len(sys.argv) > 1 else ""
    if name not in GROUPS:
        raise SystemExit(f"{__doc__}\nFirst argument: one of {', '.join(GROUPS)}.")
    sys.exit(run_groups(__doc__, name, GROUPS[name]))
