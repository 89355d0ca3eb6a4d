"""What was identified, as a document that programs read."""

import numpy as np

from residual.identification.prove import Identified
from residual.model.compare import Errors

SCHEMA = 1
KINDS = ("raw", "filtered", "moving")


def document(outcome: Identified) -> dict:
    """Return an outcome as plain values: every key always there, null for none."""
    found = outcome.found
    return {
        "schema": SCHEMA,
        "robot": outcome.robot.name,
        "declared": list(dict.fromkeys(t.effect.name for t in found.nominal.terms)),
        "method": found.options.method,
        "prior": found.options.prior,
        "logs": list(outcome.fit),
        "held_out": list(outcome.held_out),
        "same_run": outcome.same_run,
        "condition": _plain(found.estimate.condition),
        "noise": _plain(found.estimate.noise),
        "rows": _plain(found.estimate.counts),
        "independent_rows": _plain(found.estimate.independent),
        "outliers": _plain(found.estimate.outliers),
        "parameters": parameters(outcome),
        "essential": _essential(outcome),
        "error": {
            "metric": "100*||tau-tau_hat||/||tau||",
            **{kind: _errors(outcome, kind) for kind in KINDS},
        },
        "acceleration_error": {
            name: None
            if made is None
            else {"joints": _plain(made.per_joint), "overall": _plain(made.overall)}
            for name, made in outcome.accelerations.items()
        },
        "least_mass_matrix": _plain(dict(outcome.least_mass_matrix)),
        "consistent": _consistent(outcome),
        "warnings": list(outcome.warnings),
    }


def parameters(outcome: Identified) -> list[dict]:
    """Return the base parameters: value, standard deviation, and what they are."""
    found = outcome.found
    base, estimate = found.base, found.estimate
    consistent = None
    if outcome.consistent is not None:
        consistent = base.mapping @ outcome.consistent.model.coefficients()
    out = []
    for i, lead in enumerate(base.leading):
        fitted = found.status[i] == "fitted"
        out.append(
            {
                "name": lead.name,
                "joint": lead.joint,
                "unit": lead.unit,
                "is": base.words(i),
                "nominal": _plain(found.nominal_theta[i]),
                "value": _plain(estimate.theta[i]),
                "sd": _plain(estimate.sd[i]) if fitted else None,
                "relative_sd": _plain(estimate.relative_sd[i]) if fitted else None,
                "status": found.status[i],
                "consistent": None if consistent is None else _plain(consistent[i]),
            }
        )
    return out


def _errors(outcome: Identified, kind: str) -> dict:
    return {name: _error(e, kind) for name, e in outcome.errors.items()}


def _error(errors: Errors, kind: str) -> dict:
    return {
        "joints": _plain(errors.per_joint(kind)),
        "overall": _plain(errors.overall(kind)),
    }


def _essential(outcome: Identified) -> dict | None:
    made = outcome.found.essential
    if made is None:
        return None
    leading = outcome.found.base.leading
    return {
        "dropped": [leading[i].name for i in made.dropped],
        "f": _plain(made.f_value),
        "f_limit": _plain(made.f_limit),
    }


def _consistent(outcome: Identified) -> dict | None:
    made = outcome.consistent
    if made is None:
        return None
    return {
        "masses": _plain(made.model.inertial[::10]),
        "least_eigenvalue": _plain(made.least_eigenvalue),
        "poses": made.poses,
        "misfit": {
            "identified": _plain(made.misfit[0]),
            "consistent": _plain(made.misfit[1]),
        },
    }


def _plain(value: object) -> object:
    """Lists and numbers for arrays, None for what is not finite."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.integer):
        return int(value)
    number = float(value)  # type: ignore[arg-type]
    return number if np.isfinite(number) else None
