"""What was identified, as a document that programs read."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from residual.identification.prove import Identified
from residual.model.compare import Errors
from residual.model.record import to_record
from warehouse.commit import commit_record
from warehouse.schema import VIEWS, arrow_schema

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
            **{kind: _errors_of_kind(outcome, kind) for kind in KINDS},
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


def _errors_of_kind(outcome: Identified, kind: str) -> dict:
    return {name: _error_of(e, kind) for name, e in outcome.errors.items()}


def _error_of(errors: Errors, kind: str) -> dict:
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


STAGE = "identified"
# What the figures of the document are called in the view errors.
_METRICS = {"raw": "held_out", "filtered": "filtered", "moving": "moving"}


def store_identification(
    store: Path,
    outcome: Identified,
    request: Mapping,
    runs: Mapping[str, Sequence[str]],
) -> str:
    """Put an identified model into the store.

    Args:
        request: What was asked for, so that it can be made again.

    Returns:
        The id of the model; the same model of the same runs has the same.
    """
    told = document(outcome)
    record = {
        "robot": outcome.robot.name,
        "stage": STAGE,
        "request": request,
        "document": told,
        "model": to_record(outcome.found.model),
    }
    held_out = runs.get("held_out") or runs.get("fit") or ()
    one = held_out[0] if len(held_out) == 1 and not outcome.same_run else None
    tables = {
        "parameters": _table("parameters", _parameters(told)),
        "errors": _table("errors", list(_errors(told, one))),
    }
    return commit_record(store, "models", record, tables, runs)


def _parameters(told: Mapping) -> list[dict]:
    return [{**one, "std": one["sd"]} for one in told["parameters"]]


def _errors(told: Mapping, run_id: str | None) -> Iterator[dict]:
    same = {"run_id": run_id, "trajectory": None}
    for kind in KINDS:
        for stage, error in told["error"][kind].items():
            row = {**same, "stage": stage, "metric": _METRICS[kind]}
            values = enumerate(error["joints"], 1)
            for joint, value in (*values, (None, error["overall"])):
                if value is not None:
                    yield {**row, "joint": joint, "value": value}


def _table(view: str, rows: list[dict]) -> pa.Table:
    return pa.Table.from_pylist(rows, schema=arrow_schema(VIEWS[view][1:]))
