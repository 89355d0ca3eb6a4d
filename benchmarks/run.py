"""Run one benchmark: the first argument is its name.

    python benchmarks/run.py attribution --quick                   a part, under 50 s
    python benchmarks/run.py diagnosis --seeds 1:2 --groups singles      to look at
    python benchmarks/run.py peers --full-json benchmarks/results/peers.json

Over drawn cases (the seeds below decide and are used for nothing else; 1 to 99 are for
development):
attribution: is the whole set of changed values named, and nothing else? Given values of
arms of six and seven joints are exact or 1 or 3 % off; a change is 2 % of a joint's
torque or more.
changes: what changed between an earlier state of an arm and its new logs? Sizes are
shares of the torque of the joint; silence is a miss; a plain regression of both epochs
gets the same cases.
check: does the check find faults of logs, repair them, and accept sound logs? Every kind
of fault is put at three sizes into logs of simulated and measured arms; robot files have
bodies that no link has, or masses of another scale.
diagnosis: is the right effect named, at its joint, and nothing where nothing is missing?
Sizes are shares of the torque of the joint (1, 2, 5 and 10 %); only `detection` hides
the size that the diagnosis states as the least detectable one.
loop: does one designed experiment settle what a first verdict left open, and how soon?
A case takes minutes, so that a quick run measures nothing.
measured: logs and robot files of other people, as they are and with a known effect
added; plain least squares, the paper's PLSR and a greedy selection beside ours.
peers: other programs on the same hidden effects: least squares, and a sparse selection
written from the description of SAPC, not that program.

Of single rooms: plsr (peers run in the same process with one BLAS thread and are timed
in processor time), store (bars in seconds are for an idle machine; if its load was above
1 at the start, a missed one is null), identification, monitoring, servo, six_joints,
pipelines, others (cases that other people wrote down); servo_developed is the half to
work on, not to report.

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from importlib import import_module
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

# Deciding seeds; the module that draws, runs and summarises cases; that of the figures;
# and what else draws or judges cases: a change makes kept rows worthless.
DRAWN = {
    "attribution": ("166211:166218", "attribution_parts.cases", "attribution_parts.bars"),
    "changes": (
        *("166307:166309", "changes_parts.answers", "changes_parts.bars"),
        "benchmarks/check_parts",
    ),
    "check": (
        *("166402:166402", "check_parts.cases", "check_parts.bars"),
        *("flows/inputs", "flows/steps"),
    ),
    "diagnosis": ("166105:166105", "diagnosis_parts.cases", "diagnosis_parts.bars"),
    "loop": ("166601:166608", "loop_parts.next", "loop_parts.next", "flows/steps/next.py"),
    "measured": ("166704:166704", "measured_parts.cases", "measured_parts.bars"),
    "peers": ("166501:166502", "peers_parts.cases", "peers_parts.bars"),
}
# The groups of each other benchmark, in order, and the functions that measure them.
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
    "others": {"cases": "others_parts.cases:case_figures"},
}


def main(name: str) -> int:
    if name not in DRAWN | GROUPS:
        raise SystemExit(f"{__doc__}\nFirst argument: one of {', '.join(DRAWN | GROUPS)}.")
    if name in GROUPS:
        return run_groups(__doc__, name, GROUPS[name])
    from benchmarks.harness.cases import run_cases  # with its NumPy

    seeds, cases, bars, *more = DRAWN[name]
    cases, bars = (import_module(f"benchmarks.{place}") for place in (cases, bars))
    return run_cases(__doc__, name, seeds, [f"benchmarks/{name}_parts", *more], cases, bars)


if __name__ == "__main__":
    sys.exit(main(sys.argv.pop(1) if len(sys.argv) > 1 else ""))
