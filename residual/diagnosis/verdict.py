"""The verdict in its documented form: every key always there, no NaN."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.diagnose import Diagnosis
from residual.diagnosis.findings import Finding
from residual.diagnosis.gate import Tested
from residual.diagnosis.held_out import word
from residual.model.compare import Errors
from residual.recording import Array

METRIC = "100*||tau-tau_hat||/||tau||"
STAGES = ("nominal", "identified", "augmented", "plsr")


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """All that a verdict is written from.

    Attributes:
        diagnosis: The diagnosis.
        found: The findings, most important first.
        gains: Held-out gain of each tested member, by identity.
        errors: Errors of each stage on the held-out logs.
        held_out: Labels of the held-out logs.
        same_run: Whether they are a part of a fit log.
        minimum: Minimum detectable sizes.
        depends_on: What the leftover of each unexplained joint depends on.
        kinds: Kind of the leftover of each of them, or None.
        warnings: Sentences.
        p_value: Chance of so many nats where nothing is missing; None without a null.
    """

    diagnosis: Diagnosis
    found: Sequence[Finding]
    gains: Mapping[int, float]
    errors: Mapping[str, Errors]
    held_out: Sequence[str]
    same_run: bool
    minimum: Sequence[Mapping]
    depends_on: Sequence[Mapping]
    kinds: Sequence[str | None]
    warnings: Sequence[str]
    p_value: Callable[[float], float] | None = None


def write(case: Case) -> dict:
    """The verdict as a dictionary that JSON can hold (docs/verdict.md)."""
    diagnosis = case.diagnosis
    flagged = [j + 1 for j in diagnosis.adequacy.doubted]
    nothing = "unknown" if flagged else "none"
    return _plain(
        {
            "schema": 1,
            "robot": diagnosis.logs.robot.name,
            "declared": list(diagnosis.nominal.names),
            "verdict": "effects" if case.found else nothing,
            "effects": [_effect(f, i + 1, case) for i, f in enumerate(case.found)],
            "minimum_detectable": list(case.minimum),
            "unexplained": _unexplained(case),
            "error": _error(case),
            "nominal_scale": diagnosis.task.prior.scale,
            "next_experiment": None,
            "warnings": list(case.warnings),
        }
    )


def _effect(finding: Finding, order: int, case: Case) -> dict:
    single = len(finding.tested) == 1
    gain = float(np.mean([case.gains[id(t)] for t in finding.tested]))
    fits = [t for t in finding.tested if t.by == "fit"]
    return {
        "name": finding.effect.name,
        "joints": list(finding.joints),
        "probability": finding.probability,
        "order": order,
        "equivalent": [
            {"name": name, "joints": list(joints)}
            for name, joints in finding.equivalent
        ],
        "parameters": {
            key: {
                "value": value[0] if single else list(value),
                "std": std[0] if single else list(std),
                "unit": unit,
            }
            for key, (value, std, unit) in finding.parameters.items()
        },
        "evidence": {
            "nats": finding.nats,
            "by": "fit" if fits else "plausibility",
            "held_out": word(gain),
            "held_out_gain": gain,
            "p_value": case.p_value(finding.nats) if case.p_value else None,
        },
    }


def _unexplained(case: Case) -> dict:
    a, design = case.diagnosis.adequacy, case.diagnosis.task.design
    power = design.rows * design.rms**2
    weight = power / power.sum()
    kinds = [k for k in case.kinds if k]
    kind = max(sorted(set(kinds)), key=kinds.count) if kinds else None
    return {
        "joints": [j + 1 for j in a.doubted],
        "fraction": float(np.sqrt(weight @ a.structured**2)),
        "noise_floor": float(np.sqrt(weight @ a.noise**2)),
        "depends_on": list(case.depends_on),
        "kind": kind,
        "per_joint": a.structured,
        "noise_model": "autocorrelation",
    }


def _error(case: Case) -> dict:
    cutoff = min(t.cutoff for t in case.diagnosis.logs.tracks)
    tables = {
        kind: {s: _per_joint(case.errors.get(s), kind) for s in STAGES}
        for kind in ("raw", "filtered", "moving")
    }
    overall = {
        kind: {s: _overall(case.errors.get(s), kind) for s in STAGES}
        for kind in ("raw", "filtered")
    }
    return {
        "metric": METRIC,
        "filter": {"cutoff_hz": cutoff},
        "logs": list(case.held_out),
        "same_run": case.same_run,
        "held_out": tables["raw"],
        "filtered": tables["filtered"],
        "moving": tables["moving"],
        "overall": overall["raw"],
        "overall_filtered": overall["filtered"],
    }


def _per_joint(errors: Errors | None, kind: str) -> Array | None:
    """Errors of every joint; None where there are none, or no such model."""
    values = None if errors is None else errors.per_joint(kind)
    return None if values is None or np.isnan(values).all() else values


def _overall(errors: Errors | None, kind: str) -> float | None:
    return None if errors is None else errors.overall(kind)


def _plain(value):
    """Plain Python values; what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, Array):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def complaint(tested: Tested, why: str) -> str:
    """A warning about a name that did not stand: 'ripple on joint 3: why'."""
    joints = [j + 1 for j in tested.group.joints]
    place = f" on joint{'s' if len(joints) > 1 else ''} " if joints else ""
    return f"{tested.group.effect.name}{place}{', '.join(map(str, joints))}: {why}"
