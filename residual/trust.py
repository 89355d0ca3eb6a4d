"""What a diagnosis is worth whose logs are not what they say they are: no name."""

from collections.abc import Mapping
from dataclasses import replace

from residual.check.result import LogCheck
from residual.diagnosis.result import Diagnosis, ErrorTables, Verdict

_FOUND = ("augmented", "plsr")  # models that have what was named, or what remained


def with_check(found: Diagnosis, report: LogCheck) -> Diagnosis:
    """Return a diagnosis with the check of its logs.

    With a certain fault nothing is named, and nothing is said to be missing or not:
    what was found may be the fault.
    """
    warnings = (*report.sentences, *found.warnings)
    verdict = replace(found.verdict, log_check=report, warnings=warnings)
    if not report.certain:
        return replace(found, verdict=verdict)
    models = {k: m for k, m in found.models.items() if k not in _FOUND}
    if "identified" in models:
        models["augmented"] = models["identified"]
    return replace(
        found,
        verdict=_unnamed(verdict),
        models=models,
        proofs=tuple(replace(p, tau_hat=_refit(p.tau_hat)) for p in found.proofs),
        clouds=(),
        sentences=(),
    )


def _unnamed(verdict: Verdict) -> Verdict:
    return replace(
        verdict,
        verdict="unknown",
        effects=(),
        minimum_detectable=(),
        next_experiment=None,
        edit=None,
        error=_errors(verdict.error),
    )


def _errors(error: ErrorTables) -> ErrorTables:
    overall = ("overall", "overall_filtered", "overall_moving")
    tables = {
        name: _refit(getattr(error, name))
        for name in ("held_out", "filtered", "moving", *overall)
    }
    tables = {k: table | {"plsr": None} for k, table in tables.items()}
    return replace(error, worse=(), **tables)


def _refit(by_model: Mapping) -> dict:
    """Return what is known of every model, where nothing was found."""
    kept = {name: value for name, value in by_model.items() if name not in _FOUND}
    return kept | {"augmented": by_model["identified"]}
