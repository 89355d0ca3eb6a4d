"""Benchmarks whose groups are measured one by one: what each is made of.

    python benchmarks/groups.py plant --quick              a part, under 50 s
    python benchmarks/groups.py hardening --groups flips full
    python benchmarks/groups.py export --full-json benchmarks/results/export.json

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

# Of each benchmark its groups, in order, and the functions that measure them.
GROUPS = {
    "identification": {
        "identities": "identification_parts.recovery:identity_figures",
        "recovery": "identification_parts.recovery:recovery_figures",
        "measured": "identification_parts.recovery:measured_figures",
        "speed": "identification_parts.speed:speed_figures",
    },
    "plant": {
        "identity": "plant_parts.physics:identity_figures",
        "energy": "plant_parts.physics:energy_figures",
        "stability": "plant_parts.physics:stability_figures",
        "determinism": "plant_parts.physics:determinism_figures",
        "speed": "plant_parts.physics:speed_figures",
        "excitation": "plant_parts.physics:excitation_figures",
    },
    "slips": {
        "mounted": "check_parts.slips:mounted_figures",
        "twos": "check_parts.slips:twos_figures",
    },
    "fleet": {
        "first": "fleet_parts.inbox:first_figures",
        "inbox": "fleet_parts.inbox:inbox_figures",
        "objects": "fleet_parts.objects:object_figures",
    },
    "hardening": {
        "cost": "hardening_parts.damage:cost_figures",
        "inputs": "hardening_parts.inputs:input_figures",
        "flips": "hardening_parts.damage:flip_figures",
        "kills": "hardening_parts.kills:kill_figures",
        "full": "hardening_parts.damage:full_figures",
    },
    "pipelines": {
        "service": "pipelines_parts.service:service_figures",
        "efficiency": "pipelines_parts.service:efficiency_figures",
        "dask": "pipelines_parts.service:cluster_figures",
    },
}


if __name__ == "__main__":
    asked = sys.argv.pop(1) if len(sys.argv) > 1 else ""
    if asked not in GROUPS:
        raise SystemExit(f"{__doc__}\nOne of {', '.join(GROUPS)} comes first.")
    sys.exit(run_groups(__doc__, GROUPS[asked]))
