"""Verdicts and rows of blind cases, made by hand."""

from tests.verdict_documents import typed


def entry(name, joints, order=1, alike=(), parameters=None):
    """Return one finding as a verdict has it."""
    return {
        "name": name,
        "joints": list(joints),
        "order": order,
        "equivalent": [{"name": n, "joints": list(j)} for n, j in alike],
        "parameters": parameters or {"level": {"value": 1.0, "std": 0.1, "unit": ""}},
    }


def verdict(*effects, unexplained=()):
    """Return a verdict, of which only a part is judged."""
    nothing = "unknown" if unexplained else "none"
    part = {
        "verdict": "effects" if effects else nothing,
        "effects": list(effects),
        "unexplained": {"joints": list(unexplained)},
        "error": {
            "overall_filtered": {"nominal": 20.0, "identified": 8.0, "augmented": 4.4}
        },
    }
    return typed(part)


def row(drawn, outcome, **other):
    """Return one row of the view blind, but for what nobody asks here."""
    quiet = drawn == "none" and outcome == "right"
    named = int(outcome in ("right", "class", "part", "wrong") and not quiet)
    unknown = ("multiple", "second_effect", "second_joints", "second_multiple")
    usual = dict.fromkeys((*unknown, "value", "truth", "z")) | {
        "drawn": drawn,
        "effect": None if drawn == "none" else "stribeck",
        "joints": None if drawn == "none" else [2],
        "named_first": "stribeck" if named else None,
        "named_joints": [2] if named else None,
        "named": named,
        "outcome": outcome,
        "found": int(outcome in ("right", "class", "part")),
        "extra": int(outcome == "wrong"),
        "joint_right": True if named else None,
        "unexplained": [2] if outcome == "flagged" else [],
        "error_before": 20.0,
        "error_refit": 8.0,
        "error_after": 4.4,
        "error_oracle": 4.0,
        "gap_closed": 0.9,
        "seconds": 3.0,
        "case_index": 0,
        "diagnosis_id": "aa",
    }
    return usual | other
