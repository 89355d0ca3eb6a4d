"""Benchmarks of single rooms, measured group by group.

    python benchmarks/groups.py monitoring --quick         a part, under 50 s
    python benchmarks/groups.py identification
    python benchmarks/groups.py servo --groups chain
    python benchmarks/groups.py servo_developed     the half to work on, not to report
    python benchmarks/groups.py pipelines --full-json OUT

plsr: peers run in the same process with one BLAS thread and are timed in processor time.
store: bars in seconds are for an idle machine; if its load was above 1 at the start, a
missed one is null. The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

# The groups of each benchmark, in order, and the functions that measure them.
GROUPS = {
    "plsr": {
        "fit": "plsr_parts.speed:fit_figures",
        "errors": "plsr_parts.errors:paper_set_figures",
        "measured": "plsr_parts.errors:measured_figures",
    },
    "store": {
        "commit": "store_parts.speed:commit_figures",
        "many": "store_parts.speed:many_figures",
    },
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
