"""Each of the effects, on both arms, through each target and back."""

from collections.abc import Sequence

from benchmarks.export_parts.models import ARMS, NAMES, model_with, robot_of
from benchmarks.figures import Figures, figure, missing, partial
from flows.proofs.c import compiler
from flows.steps.export import Made, export_model

# Bars of what a target carries [N m]; those of c99 and numpy are per N m of torque.
BARS = {
    "json": 0.0,
    "urdf": 1e-12,
    "mjcf": 1e-9,
    "c99": 1e-12,
    "numpy": 1e-12,
    "fmu": 1e-9,
    "rrd": 1e-9,
    "table": None,
}
RELATIVE = ("c99", "numpy", "table")
COMPILED = ("c99", "fmu")
BESIDE = "viscous"  # so that there is a torque where the effect cannot be carried
FEW = ("coulomb", "payload", "elasticity")  # of a quick run


def target_figures(quick: bool) -> Figures:
    """Measure every target; a quick run takes three effects and one arm."""
    arms, names = (ARMS[:1], FEW) if quick else (ARMS, NAMES)
    out: Figures = {}
    for target, bar in BARS.items():
        if target in COMPILED and compiler() is None:
            out[target] = missing(bar, "no C compiler here")
            continue
        made = {(arm, n): _exported(target, arm, n) for arm in arms for n in names}
        entry = _figure(target, bar, made)
        out[target] = partial(entry, "three effects, one arm") if quick else entry
        print(f"{target}: {entry['value']:.3g}", flush=True)
        out[f"{target}_carries"] = _carried(names, made)
    return out


def _exported(target: str, arm: str, name: str) -> Made:
    robot = robot_of(arm)
    # An MJCF spring holds a constant torque only where there is one.
    return export_model(model_with(robot, *dict.fromkeys((BESIDE, name))), target)


def _figure(target: str, bar: float | None, made: dict) -> dict:
    gaps = {}
    for (arm, name), each in made.items():
        size = max(each.proof.torque, 1e-9) if target in RELATIVE else 1.0
        gaps[arm, name] = each.proof.difference / size
    (arm, name), worst = max(gaps.items(), key=lambda item: item[1])
    states = sum(each.proof.states for each in made.values())
    return figure(
        worst, bar, len(gaps), what=f"{states} states", worst=f"{name}, {arm}"
    )


def _carried(names: Sequence[str], made: dict) -> dict:
    """How many effects are carried; all others must be listed with a torque."""
    lost, silent = {}, []
    for (_, name), each in made.items():
        kept = {t.effect.name for t in _terms(each)}
        left = [one for one in each.export.left if one.name == name]
        if name not in kept:
            lost[name] = max(lost.get(name, 0.0), *(one.largest for one in left), 0.0)
        if (name in kept) == bool(left):
            silent.append(name)
    left = ", ".join(f"{k} {v:.2g}" for k, v in lost.items()) or "nothing"
    told = f"left out, with the torque that is missing [N m]: {left}"
    entry = figure(len(names) - len(lost), None, len(names), what=told)
    return entry | {"ok": False if silent else None}


def _terms(each: Made):
    carried = each.export.carried
    return getattr(carried, "model", carried).terms
