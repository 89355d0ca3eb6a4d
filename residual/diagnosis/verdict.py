"""The verdict as JSON and back: the one place that knows the keys (docs/verdict.md).

Every key is always there; what does not apply is null, and nothing is NaN.
"""

from collections.abc import Mapping
from dataclasses import asdict

from residual.check.result import LogCheck
from residual.check.result import from_json as read_report
from residual.diagnosis.result import (
    Alternative,
    Change,
    Dependence,
    Detectable,
    Drift,
    Edit,
    ErrorTables,
    Evidence,
    Finding,
    Frames,
    Parameter,
    Place,
    Splits,
    Unexplained,
    Value,
    Verdict,
)
from residual.errors import InputError, shown
from residual.model.bodies import Moved
from residual.quantity import plain

SCHEMA = 1
_PER_JOINT = ("held_out", "filtered", "moving")
_OVERALL = ("overall", "overall_filtered", "overall_moving")


def to_json(verdict: Verdict) -> dict:
    """Return a verdict as JSON can hold it, in its documented form."""
    return plain(
        {
            "schema": SCHEMA,
            "robot": verdict.robot,
            "declared": verdict.declared,
            "verdict": verdict.verdict,
            "effects": [_effect(f) for f in verdict.effects],
            "minimum_detectable": [_detectable(d) for d in verdict.minimum_detectable],
            "unexplained": _unexplained(verdict.unexplained),
            "error": _error(verdict.error),
            "nominal_scale": verdict.nominal_scale,
            "next_experiment": verdict.next_experiment,
            "warnings": verdict.warnings,
            "log_check": verdict.log_check and verdict.log_check.to_json(),
            "contradictions": verdict.contradictions,
            "drift": verdict.drift and asdict(verdict.drift),
            "background": [_effect(f) for f in verdict.background],
            "changes": [asdict(c) for c in verdict.changes],
            "alternatives": [asdict(a) for a in verdict.alternatives],
            "edit": None if verdict.edit is None else [asdict(e) for e in verdict.edit],
            "bodies": verdict.bodies and asdict(verdict.bodies),
            "frames": asdict(verdict.frames),
            "suspected": [_effect(f) for f in verdict.suspected],
            "too_small": verdict.too_small,
        }
    )


def from_json(document: Mapping) -> Verdict:
    """Return the verdict of a document.

    Raises:
        InputError: If it is of another schema, or a key is missing.
    """
    if document.get("schema") != SCHEMA:
        raise InputError(
            f"A verdict of schema {document.get('schema')!r}, expected {SCHEMA}: "
            "diagnose its logs again."
        )
    try:
        effects = map(_read_effect, document["effects"])
        return Verdict(
            robot=document["robot"],
            declared=tuple(document["declared"]),
            verdict=document["verdict"],
            effects=tuple(sorted(effects, key=lambda f: f.order)),
            minimum_detectable=tuple(
                Detectable(
                    d["name"],
                    tuple(d["joints"]),
                    d["value"],
                    d["unit"],
                    _read_places(d["confusable"]),
                )
                for d in document["minimum_detectable"]
            ),
            unexplained=_read_unexplained(document["unexplained"]),
            error=_read_error(document["error"]),
            nominal_scale=document["nominal_scale"],
            next_experiment=document["next_experiment"],
            warnings=tuple(document["warnings"]),
            log_check=_read_check(document["log_check"]),
            contradictions=tuple(document["contradictions"]),
            drift=_read_drift(document["drift"]),
            background=tuple(map(_read_effect, document["background"])),
            changes=tuple(map(_read_change, document["changes"])),
            alternatives=tuple(map(_read_set, document["alternatives"])),
            edit=_read_edit(document["edit"]),
            bodies=_read_bodies(document["bodies"]),
            frames=_read_frames(document["frames"]),
            suspected=tuple(map(_read_effect, document.get("suspected", ()))),
            too_small=tuple(document.get("too_small", ())),
        )
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError(f"This is no whole verdict: {shown(error)}.") from error


def _read_check(entry: Mapping | None) -> LogCheck | None:
    return None if entry is None else read_report(entry)


def _read_change(entry: Mapping) -> Change:
    return Change(**{**entry, "joints": tuple(entry["joints"])})


def _read_set(entry: Mapping) -> Alternative:
    return Alternative(**{**entry, "set": _read_places(entry["set"])})


def _read_drift(entry: Mapping | None) -> Drift | None:
    if entry is None:
        return None
    return Drift(**{**entry, "joints": tuple(entry["joints"])})


def _read_edit(entries: list | None) -> tuple[Edit, ...] | None:
    if entries is None:
        return None
    return tuple(Edit(**{**e, "joints": tuple(e["joints"])}) for e in entries)


def _read_bodies(entry: Mapping | None) -> Moved | None:
    if entry is None:
        return None
    return Moved(tuple(entry["bodies"]), tuple(entry["price"]), entry["chance"])


def _read_frames(entry: Mapping) -> Frames:
    return Frames(tuple(entry["joints"]), entry["flange"])


def _effect(finding: Finding) -> dict:
    evidence = finding.evidence
    return {
        "name": finding.name,
        "joints": finding.joints,
        "probability": finding.probability,
        "order": finding.order,
        "equivalent": _places(finding.equivalent),
        "parameters": {
            key: {**_parameter(p), "determined": p.determined}
            for key, p in finding.parameters.items()
        },
        "combinations": {key: _parameter(p) for key, p in finding.combinations.items()},
        "evidence": {
            "nats": evidence.nats,
            "by": evidence.by,
            "held_out": evidence.held_out,
            "held_out_gain": evidence.held_out_gain,
            "p_value": None,
            "splits": evidence.splits and asdict(evidence.splits),
        },
    }


def _parameter(parameter: Parameter) -> dict:
    return {
        "value": parameter.value,
        "std": parameter.std,
        "unit": parameter.unit,
    }


def _read_parameters(entries: Mapping) -> dict[str, Parameter]:
    # A combination is determined, and does not say so.
    return {
        key: Parameter(
            _read_value(p["value"]),
            _read_value(p["std"]),
            p["unit"],
            p.get("determined", True),
        )
        for key, p in entries.items()
    }


def _read_effect(entry: Mapping) -> Finding:
    return Finding(
        name=entry["name"],
        joints=tuple(entry["joints"]),
        probability=entry["probability"],
        order=entry["order"],
        equivalent=_read_places(entry["equivalent"]),
        parameters=_read_parameters(entry["parameters"]),
        combinations=_read_parameters(entry["combinations"]),
        evidence=_read_evidence(entry["evidence"]),
    )


def _read_evidence(entry: Mapping) -> Evidence:
    known = {key: value for key, value in entry.items() if key != "p_value"}
    splits = entry["splits"]
    return Evidence(**{**known, "splits": splits and Splits(**splits)})


def _read_value(value: float | list | None) -> Value:
    return tuple(value) if isinstance(value, list) else value


def _places(places: tuple[Place, ...]) -> list[dict]:
    return [{"name": p.name, "joints": p.joints} for p in places]


def _read_places(entries: list) -> tuple[Place, ...]:
    return tuple(Place(e["name"], tuple(e["joints"])) for e in entries)


def _detectable(one: Detectable) -> dict:
    return {
        "name": one.name,
        "joints": one.joints,
        "value": one.value,
        "unit": one.unit,
        "confusable": _places(one.confusable),
    }


def _unexplained(left: Unexplained) -> dict:
    return {
        "joints": left.joints,
        "fraction": left.fraction,
        "noise_floor": left.noise_floor,
        "depends_on": [
            {
                "joint": d.joint,
                "on": d.on,
                "of": d.of,
                "form": d.form,
                "share": d.share,
                "frequency": d.frequency,
            }
            for d in left.depends_on
        ],
        "kind": left.kind,
        "per_joint": left.per_joint,
        "noise_model": left.noise_model,
    }


def _read_unexplained(entry: Mapping) -> Unexplained:
    depends_on = [Dependence(**d | {"of": tuple(d["of"])}) for d in entry["depends_on"]]
    return Unexplained(
        joints=tuple(entry["joints"]),
        fraction=entry["fraction"],
        noise_floor=entry["noise_floor"],
        depends_on=tuple(depends_on),
        kind=entry["kind"],
        per_joint=tuple(entry["per_joint"]),
        noise_model=entry["noise_model"],
    )


def _error(error: ErrorTables) -> dict:
    return {
        "metric": error.metric,
        "filter": {"cutoff_hz": error.cutoff_hz},
        "logs": error.logs,
        "same_run": error.same_run,
        **{kind: getattr(error, kind) for kind in (*_PER_JOINT, *_OVERALL)},
        "worse": error.worse,
    }


def _read_error(entry: Mapping) -> ErrorTables:
    tables = {
        kind: {k: None if v is None else tuple(v) for k, v in entry[kind].items()}
        for kind in _PER_JOINT
    }
    return ErrorTables(
        metric=entry["metric"],
        cutoff_hz=entry["filter"]["cutoff_hz"],
        logs=tuple(entry["logs"]),
        same_run=entry["same_run"],
        **tables,
        **{kind: dict(entry[kind]) for kind in _OVERALL},
        worse=tuple(entry["worse"]),
    )
