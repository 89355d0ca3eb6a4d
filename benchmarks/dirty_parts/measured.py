"""Logs of real arms, one part as the baseline of another: nothing has changed there."""

from collections.abc import Mapping, Sequence
from itertools import permutations

from benchmarks.diagnosis_parts.measured import KR300, UR10
from benchmarks.figures import Figures, figure, missing
from benchmarks.logs_parts.measured import data_folder
from flows.blind.score import members
from residual.close import close_the_loop
from residual.robot.robot import load_robot
from warehouse.ids import plain
from warehouse.logs import read_log

LWR4 = "lwr4"
_PARTS = {
    KR300: ("run_A.csv", "run_B.csv", "run_C.csv"),
    UR10: ("run.csv@:33%", "run.csv@33%:67%", "run.csv@67%:"),
    LWR4: ("run_1.csv", "run_2.csv", "run_3.csv"),
}

Job = tuple[str, str, str]


def jobs(quick: bool) -> list[Job]:
    """Return arm, baseline and new log of every order; none where logs are absent."""
    folder = data_folder()
    if folder is None or quick:
        return []
    return [
        (arm, *pair)
        for arm, parts in _PARTS.items()
        if (folder / arm).is_dir()
        for pair in permutations(parts, 2)
    ]


def run(job: Job) -> dict:
    """Diagnose one part of an arm's logs with another as the baseline.

    Args:
        job: Arm, part before, part after.
    """
    arm, before, after = job
    folder = data_folder()
    assert folder is not None
    robot = load_robot(folder / arm / f"{arm}.urdf")
    parts = [read_log(str(folder / arm / p), robot)[0] for p in (before, after)]
    verdict = close_the_loop(robot, parts[1:], parts[:1]).verdict
    return {
        "arm": arm,
        "baseline": before,
        "new": after,
        "said": [str(said.name) for said in members(verdict)],
        "drift": plain(getattr(verdict, "drift", None)),
        "unexplained": list(verdict.unexplained.joints),
        "warnings": list(verdict.warnings),
    }


def measured_figures(results: Sequence[Mapping]) -> Figures:
    """Return how many of the orders name something; null where the logs are absent."""
    if not results:
        why = "no measured logs here, or a quick run"
        return {"measured_orders_named": missing(0, why)}
    good = [r for r in results if "error" not in r]
    named = {
        f"{r['arm']} {r['baseline']} -> {r['new']}": r["said"]
        for r in good
        if r["said"]
    }
    return {
        "measured_orders_named": figure(len(named), 0, len(good), which=named),
        "measured_crashes": figure(len(results) - len(good), 0, len(results)),
    }
