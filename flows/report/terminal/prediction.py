"""Errors of a model on logs, in the terminal."""

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from residual.diagnosis.result import ErrorTables
from residual.model.compare import EDITED, WHOLE
from residual.quantity import bare_percent, known

_WORDS = {WHOLE: "", EDITED: "\nedited"}
_KINDS = (("held_out", "as logged"), ("filtered", "filtered"), ("moving", "moving"))


def print_errors(errors: ErrorTables, console: Console) -> None:
    """Print errors per joint, of the model and of the edited one.

    Args:
        errors: Errors against the measured torque [%].
    """
    title = f"Error in % of torque ({', '.join(errors.logs)})"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    table.add_column("joint")
    columns = [
        (getattr(errors, kind)[name], f"{head}{word}")
        for kind, head in _KINDS
        for name, word in _WORDS.items()
        if name in errors.overall
    ]
    for _, head in columns:
        table.add_column(head, justify="right")
    dof = max((len(values) for values, _ in columns if values), default=0)
    for j in range(dof):
        cells = (_cell(values and values[j]) for values, _ in columns)
        table.add_row(str(j + 1), *cells)
    table.add_row("all", *_overall(errors))
    if dof:
        console.print(table)
    else:
        console.print("The logs have no measured torque to compare with.")


def _overall(errors: ErrorTables) -> list[str]:
    kinds = (errors.overall, errors.overall_filtered)
    return [_cell(of[name]) for of in kinds for name in _WORDS if name in of]


def _cell(value: float | None) -> str:
    return bare_percent(value) if known(value) else "–"
