"""Group 1: the augmented model against plain least squares on logs of real arms."""

import os
from dataclasses import asdict
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.figures import ROOT, Figures, figure, missing, partial
from benchmarks.logs_parts.peer import peer_errors
from residual.close import close_the_loop
from residual.diagnosis.result import Finding
from residual.plain import plain
from residual.robot.robot import load_robot
from warehouse.logs import read_log

ROTATIONS = ("AB|C", "AC|B", "BC|A")
_NOT_WORSE = 1.02  # augmented over least squares, on any joint
_BETTER = 0.95  # ... on three joints in two rotations
_ONE_ROTATION = "one rotation of three; the full run decides"


def data_folder() -> Path | None:
    """Return the folder of measured logs, None where it is not there."""
    folder = Path(os.environ.get("MODELGAP_DATA") or ROOT.parent / "shared" / "data")
    return folder if (folder / "kr300" / "kr300.urdf").exists() else None


def measure(name: str) -> dict:
    """Diagnose one split of measured logs.

    Args:
        name: "UR10", or a rotation of KR300: logs to fit, a bar, the log held out.

    Returns:
        Filtered errors per joint of each model and of the peer [%], the findings.
    """
    folder = data_folder()
    if name == "UR10":
        robot = load_robot(folder / "ur10" / "ur10.urdf")
        run = folder / "ur10" / "run.csv"
        specs = [f"{run}@:60%"], [f"{run}@60%:"]
    else:
        robot = load_robot(folder / "kr300" / "kr300.urdf")
        specs = [
            [str(folder / "kr300" / f"run_{letter}.csv") for letter in part]
            for part in name.split("|")
        ]
    fit, held_out = ([read_log(s, robot)[0] for s in part] for part in specs)
    start = perf_counter()
    verdict = close_the_loop(robot, fit, (), held_out).verdict
    seconds = perf_counter() - start
    errors = verdict.error.filtered
    peers = peer_errors(robot, fit, held_out)
    return {
        "split": name,
        "filtered": {k: errors[k] for k in ("nominal", "identified", "augmented")},
        "moving": verdict.error.moving["augmented"],
        "least_squares": {k: v.tolist() for k, v in peers.items()},
        "effects": [_short(e) for e in verdict.effects],
        "unexplained": list(verdict.unexplained.joints),
        "warnings": list(verdict.warnings),
        "seconds": round(seconds, 1),
    }


def measured_figures(results: list[dict], quick: bool) -> Figures:
    """Return the figures of this group; null where the data are absent."""
    if not results:
        why = "no measured logs: neither ../shared/data nor $MODELGAP_DATA"
        names = ("kr300_worst_joint_ratio", "kr300_rotations_better")
        absent = {name: missing(None, why) for name in names}
        return absent | {"ur10_worst_joint_ratio": missing(_NOT_WORSE, why)}
    kr300 = [r for r in results if r["split"] in ROTATIONS]
    figures = {"kr300_worst_joint_ratio": _worst(kr300)}
    better = sum(int((_ratio(r) <= _BETTER).sum()) >= 3 for r in kr300)
    figures["kr300_rotations_better"] = figure(
        better, 2, len(kr300), ok=better >= 2, at_least=True
    )
    figures["ur10_worst_joint_ratio"] = _worst(
        [r for r in results if r["split"] == "UR10"]
    )
    if quick:
        entry = partial(figures["kr300_worst_joint_ratio"], _ONE_ROTATION)
        figures["kr300_worst_joint_ratio"] = entry
        figures["kr300_rotations_better"] |= {"ok": None, "why": _ONE_ROTATION}
    return figures


def show_measured(result: dict) -> None:
    """Print one split: errors per joint and what was named."""
    print(f"\n{result['split']}: filtered held-out error per joint [%]")
    rows = {**result["filtered"]}
    rows |= {f"LS {k}": v for k, v in result["least_squares"].items()}
    rows["augmented / LS"] = [100 * x for x in _ratio(result)]
    for label, values in rows.items():
        print(f"  {label:15}" + "".join(f"{v:8.1f}" for v in values))
    named = ", ".join(f"{e['name']} {e['joints']}" for e in result["effects"])
    print(f"  named: {named or 'nothing'}; unexplained: {result['unexplained']}")


def _ratio(result: dict, variant: str = "ordinary") -> np.ndarray:
    peer = np.array(result["least_squares"][variant])
    return np.array(result["filtered"]["augmented"]) / peer


def _worst(results: list[dict]) -> dict:
    """Return the largest ratio over splits and joints, the other peers beside it."""
    ratios = {
        variant: max(float(_ratio(r, variant).max()) for r in results)
        for variant in results[0]["least_squares"]
    }
    joints = sum(len(r["moving"]) for r in results)
    value = round(ratios.pop("ordinary"), 4)
    against = {
        f"ratio_to_{k.replace(' ', '_')}": round(v, 4) for k, v in ratios.items()
    }
    return figure(value, _NOT_WORSE, joints, peer="ordinary least squares", **against)


def _short(effect: Finding) -> dict:
    return {k: v for k, v in plain(asdict(effect)).items() if k != "order"}
