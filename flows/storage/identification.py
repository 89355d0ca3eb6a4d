"""What was identified: a document that programs read, and a record of the store."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from residual.identification.prove import ValidatedIdentification
from residual.model.record import to_record
from residual.quantity import plain
from warehouse.commit import commit_record
from warehouse.schema import rows_table

SCHEMA, STAGE = 1, "identified"
KINDS = ("raw", "filtered", "moving")
# What the figures of the document are called in the view errors.
_METRICS = {"raw": "held_out", "filtered": "filtered", "moving": "moving"}


def document(outcome: ValidatedIdentification) -> dict:
    """Return an outcome as plain values: every key always there, null for none."""
    found, estimate = outcome.free, outcome.free.estimate
    return plain(
        {
            "schema": SCHEMA,
            "robot": outcome.robot.name,
            "declared": list(dict.fromkeys(t.effect.name for t in found.nominal.terms)),
            "method": found.options.method,
            "prior": found.options.prior,
            "logs": outcome.fit,
            "held_out": outcome.held_out,
            "same_run": outcome.same_run,
            "condition": estimate.condition,
            "noise": estimate.noise,
            "rows": estimate.counts,
            "independent_rows": estimate.independent,
            "outliers": estimate.outliers,
            "parameters": parameters(outcome),
            "essential": _essential(outcome),
            "error": {
                "metric": "100*||tau-tau_hat||/||tau||",
                **{kind: _errors_of_kind(outcome, kind) for kind in KINDS},
            },
            "acceleration_error": {
                name: made and {"joints": made.per_joint, "overall": made.overall}
                for name, made in outcome.accelerations.items()
            },
            "least_mass_matrix": outcome.least_mass_matrix,
            "consistent": _consistent(outcome),
            "warnings": outcome.warnings,
        }
    )


def parameters(outcome: ValidatedIdentification) -> list[dict]:
    """Return the base parameters: value, standard deviation, and what they are."""
    return [plain(row) for row in _base_parameters(outcome)]


def _base_parameters(outcome: ValidatedIdentification) -> Iterator[dict]:
    found, estimate = outcome.free, outcome.free.estimate
    consistent = None
    if outcome.consistent is not None:
        consistent = found.base.mapping @ outcome.consistent.model.coefficients()
    for i, lead in enumerate(found.base.leading):
        fitted = found.status[i] == "fitted"
        yield {
            "name": lead.name,
            "joint": lead.joint,
            "unit": lead.unit,
            "is": found.base.words(i),
            "nominal": found.nominal_theta[i],
            "value": estimate.theta[i],
            "sd": estimate.sd[i] if fitted else None,
            "relative_sd": estimate.relative_sd[i] if fitted else None,
            "status": found.status[i],
            "consistent": None if consistent is None else consistent[i],
        }


def _errors_of_kind(outcome: ValidatedIdentification, kind: str) -> dict:
    return {
        name: {"joints": errors.per_joint(kind), "overall": errors.overall(kind)}
        for name, errors in outcome.errors.items()
    }


def _essential(outcome: ValidatedIdentification) -> dict | None:
    made, leading = outcome.free.essential, outcome.free.base.leading
    if made is None:
        return None
    dropped = [leading[i].name for i in made.dropped]
    return {"dropped": dropped, "f": made.f_value, "f_limit": made.f_limit}


def _consistent(outcome: ValidatedIdentification) -> dict | None:
    made = outcome.consistent
    if made is None:
        return None
    identified, consistent = made.misfit
    return {
        "masses": made.model.inertial[::10],
        "least_eigenvalue": made.least_eigenvalue,
        "poses": made.poses,
        "misfit": {"identified": identified, "consistent": consistent},
    }


def store_identification(
    store: Path,
    outcome: ValidatedIdentification,
    request: Mapping,
    runs: Mapping[str, Sequence[str]],
) -> str:
    """Put an identified model into the store.

    Returns:
        The id of the model; the same model of the same runs has the same.
    """
    figures = document(outcome)
    record = {
        "robot": outcome.robot.name,
        "stage": STAGE,
        "request": request,
        "document": figures,
        "model": to_record(outcome.free.model),
    }
    held_out = runs.get("held_out") or runs.get("fit") or ()
    one = held_out[0] if len(held_out) == 1 and not outcome.same_run else None
    tables = {
        "parameters": rows_table("parameters", _parameters(figures)),
        "errors": rows_table("errors", _errors(figures, one)),
    }
    return commit_record(store, "models", record, tables, runs)


def _parameters(figures: Mapping) -> list[dict]:
    return [{**one, "std": one["sd"]} for one in figures["parameters"]]


def _errors(figures: Mapping, run_id: str | None) -> Iterator[dict]:
    same = {"run_id": run_id, "trajectory": None}
    for kind in KINDS:
        for stage, error in figures["error"][kind].items():
            row = {**same, "stage": stage, "metric": _METRICS[kind]}
            values = enumerate(error["joints"], 1)
            for joint, value in (*values, (None, error["overall"])):
                if value is not None:
                    yield {**row, "joint": joint, "value": value}
