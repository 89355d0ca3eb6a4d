"""Whole verdicts for tests that look at a part of one: the rest is filled in."""

from residual.verdict.document import from_json
from residual.verdict.result import Verdict

MODELS = ("nominal", "identified", "augmented", "plsr")


def whole_document(part: dict, dof: int = 6) -> dict:
    """Return the document of a verdict in which what is not given is unknown."""
    effects = [finding(i, e) for i, e in enumerate(part.get("effects", ()), 1)]
    return {
        "schema": 1,
        "robot": "two_link",
        "declared": [],
        "verdict": "effects" if effects else "none",
        "minimum_detectable": [],
        "nominal_scale": None,
        "next_experiment": None,
        "warnings": [],
        **{key: None for key in ("log_check", "drift", "edit", "bodies")},
        **{key: [] for key in ("contradictions", "background", "changes")},
        "alternatives": [],
        "frames": {"joints": [f"joint_{j}" for j in range(1, dof + 1)], "flange": ""},
        **part,
        "effects": effects,
        "unexplained": unexplained(dof, part.get("unexplained") or {}),
        "error": errors(part.get("error") or {}),
    }


def typed(part: dict, dof: int = 6) -> Verdict:
    return from_json(whole_document(part, dof))


def finding(order: int, part: dict) -> dict:
    keys = ("nats", "by", "held_out", "held_out_gain", "p_value", "splits")
    none = dict.fromkeys(keys)
    return {
        "name": "",
        "joints": [],
        "probability": None,
        "order": order,
        "equivalent": [],
        "parameters": {},
        "combinations": {},
        **part,
        "evidence": none | part.get("evidence", {}),
    }


def unexplained(dof: int, part: dict) -> dict:
    return {
        "joints": [],
        "fraction": None,
        "noise_floor": None,
        "depends_on": [],
        "kind": None,
        "per_joint": [None] * dof,
        "noise_model": None,
        **part,
    }


def errors(part: dict) -> dict:
    """Return the proof; a model that is not given has no errors."""
    none = dict.fromkeys(MODELS)
    tables = ("held_out", "filtered", "moving", "overall", "overall_filtered")
    tables += ("overall_moving",)
    return {
        "metric": "100*||tau-tau_hat||/||tau||",
        "filter": {"cutoff_hz": None},
        "logs": [],
        "same_run": False,
        "worse": [],
        "position": None,
        **part,
        **{name: none | (part.get(name) or {}) for name in tables},
    }
