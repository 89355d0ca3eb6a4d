"""A diagnosis on a few lines of HTML, for the cell of a notebook."""

from flows.report.page.base import environment
from flows.report.words.verdict import sentences
from residual.diagnosis.result import Diagnosis


def summary(found: Diagnosis) -> str:
    """Return the headline, the effects, and the errors before and after, escaped."""
    errors = found.errors
    rows = [
        (name, values, errors.overall_filtered[name])
        for name, values in errors.filtered.items()
        if values is not None
    ]
    return (
        environment()
        .get_template("summary.html")
        .render(
            headline=sentences(found.verdict)[0],
            effects=found.effects,
            logs=errors.logs,
            joints=range(1, found.verdict.dof + 1),
            errors=rows,
            warnings=found.warnings,
        )
    )
