"""Write an identification as a JSON document and as a record of the store."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from residual.identification.identify import ValidatedIdentification
from residual.quantity import convert_to_plain_values
from warehouse.record_commit import commit_record
from warehouse.view_schema import build_view_table

SCHEMA, STAGE = 1, "identified"
KINDS = ("raw", "filtered", "moving")


def build_identification_document(outcome: ValidatedIdentification) -> dict:
    """Return an outcome as plain values: every key always there, null for none."""
    found, estimate = outcome.free, outcome.free.estimate
    consistent = outcome.consistent
    return convert_to_plain_values(
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
            "independent_rows": estimate.independent_rows,
            "outliers": estimate.outliers,
            "parameters": build_parameter_rows(outcome),
            "error": {
                "metric": "100*||tau-tau_hat||/||tau||",
                **{
                    kind: {
                        name: {"joints": e.per_joint(kind), "overall": e.overall(kind)}
                        for name, e in outcome.errors.items()
                    }
                    for kind in KINDS
                },
            },
            "acceleration_error": {
                name: made
                and {"joints": made.per_joint("moving"), "overall": made.overall("moving")}
                for name, made in outcome.accelerations.items()
            },
            "least_mass_matrix": outcome.least_mass_matrix,
            "consistent": consistent
            and {
                "masses": consistent.model.inertial[::10],
                "least_eigenvalue": consistent.least_eigenvalue,
                "poses": consistent.poses,
                "misfit": dict(zip(("identified", "consistent"), consistent.misfit, strict=True)),
            },
            "warnings": outcome.warnings,
        }
    )


def build_parameter_rows(outcome: ValidatedIdentification) -> list[dict]:
    """Return the base parameters: value, standard deviation, and what they are."""
    found, estimate, other = outcome.free, outcome.free.estimate, outcome.consistent
    consistent = other and found.base.mapping @ other.model.coefficients()
    rows = []
    for i, lead in enumerate(found.base.leading):
        fitted = found.status[i] == "fitted"
        row = {
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
        rows.append(convert_to_plain_values(row))
    return rows


def store_identification(
    store: Path,
    outcome: ValidatedIdentification,
    request: Mapping,
    runs: Mapping[str, Sequence[str]],
    seconds: Mapping[str, float],
) -> str:
    """Put an identified model into the store.

    Returns:
        The id of the model; the same model of the same runs has the same.
    """
    figures = build_identification_document(outcome)
    record = {
        "robot": outcome.robot.name,
        "stage": STAGE,
        "request": request,
        "document": figures,
        "model": outcome.free.model.to_record(),
    }
    held_out = runs.get("held_out") or runs.get("fit") or ()
    one = held_out[0] if len(held_out) == 1 and not outcome.same_run else None
    common = {"run_id": one, "trajectory": None}
    errors = [
        {**common, "stage": stage, "metric": metric, "joint": joint, "value": value}
        for kind, metric in zip(KINDS, ("held_out", *KINDS[1:]), strict=True)
        for stage, error in figures["error"][kind].items()
        for joint, value in (*enumerate(error["joints"], 1), (None, error["overall"]))
        if value is not None
    ]
    parameters = [{**row, "std": row["sd"]} for row in figures["parameters"]]
    tables = {
        "parameters": build_view_table("parameters", parameters),
        "errors": build_view_table("errors", errors),
    }
    return commit_record(store, "models", record, tables, runs, seconds=seconds)
