"""What was identified, in the terminal: parameters, errors, and what to doubt."""

from collections.abc import Sequence

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from flows.outputs import say
from residual.identification.prove import Identified

_KINDS = (("raw", "as logged"), ("filtered", "filtered"), ("moving", "moving"))
_NARROW = 58


def print_outcome(outcome: Identified, console: Console) -> None:
    """Print an identification."""
    if not console.is_terminal:
        # Into a file or a pipe: as wide as it needs, nothing is cut.
        console = Console(file=console.file, width=200)
    console.print(_parameters(outcome))
    say(console, *_sentences(outcome), *(f"warning: {w}" for w in outcome.warnings))
    console.print(_errors(outcome))
    say(console, *_proof(outcome))


def _parameters(outcome: Identified) -> Table:
    found, extra = outcome.found, outcome.consistent
    titles = ["parameter (as a sum of standard ones)", "unit", "nominal", "value"]
    titles += ["sd", "sd %"] + (["consistent"] if extra else [])
    table = _table(titles, 2)
    base, estimate = found.base, found.estimate
    other = base.mapping @ extra.model.coefficients() if extra else None
    for i, lead in enumerate(base.leading):
        status = found.status[i]
        sds = [status, ""]
        if status == "fitted":
            sds = [f"{estimate.sd[i]:.2g}", f"{100 * estimate.relative_sd[i]:.3g}"]
        row = [base.words(i), lead.unit, f"{found.nominal_theta[i]:.5g}"]
        row += [f"{estimate.theta[i]:.5g}", *sds]
        table.add_row(*row, *([] if other is None else [f"{other[i]:.5g}"]))
    return table


def _sentences(outcome: Identified) -> list[str]:
    found = outcome.found
    estimate = found.estimate
    noise = ", ".join(f"{n:.3g}" for n in estimate.noise)
    lines = [
        f"{found.options.method} on {estimate.counts.sum()} moving rows, worth "
        f"{estimate.independent.sum():.0f} independent ones; condition "
        f"{estimate.condition:.3g}",
        f"noise per joint [N m]: {noise}",
    ]
    if found.options.method == "irls":
        shares = ", ".join(f"{100 * s:.1f}" for s in estimate.outliers)
        lines.append(f"rows that hardly count [%]: {shares}")
    if found.essential is not None:
        gone = len(found.essential.dropped)
        lines.append(
            f"{gone} of {len(found.base)} parameters are not needed and were set to 0 "
            f"(F {found.essential.f_value:.3g}, limit {found.essential.f_limit:.3g})"
        )
    return lines


def _errors(outcome: Identified) -> Table:
    joints = range(1, outcome.robot.dof + 1)
    titles = ["error on held-out motion [%]", "model", *(f"J{j}" for j in joints)]
    table = _table([*titles, "all"], 2)
    for kind, words in _KINDS:
        for name, errors in outcome.errors.items():
            cells = [*map(_percent, errors.per_joint(kind))]
            table.add_row(words, name, *cells, _percent(errors.overall(kind)))
    for name, made in outcome.accelerations.items():
        if made is not None:
            cells = [*map(_percent, made.per_joint)]
            table.add_row("acceleration", name, *cells, _percent(made.overall))
    return table


def _proof(outcome: Identified) -> list[str]:
    lines = []
    if outcome.consistent is not None:
        made = outcome.consistent
        free, own = (
            outcome.errors[n].overall("filtered") for n in ("identified", "consistent")
        )
        lines.append(
            f"consistent: every pseudo-inertia is positive (least eigenvalue "
            f"{made.least_eigenvalue.min():.2g} of its scale); error {own:.3g} % where "
            f"the free fit reaches {free:.3g} %"
        )
    for name, value in outcome.least_mass_matrix.items():
        lines.append(
            f"least eigenvalue of M(q), 10 000 random poses, {name}: {value:.3g} kg m^2"
        )
    return lines


def _table(titles: Sequence[str], left: int) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for i, title in enumerate(titles):
        side = "left" if i < left else "right"
        # What a parameter is made of may take several lines; numbers may not.
        table.add_column(
            title.replace("[", "\\["),
            justify=side,
            max_width=None if i else _NARROW,
            no_wrap=bool(i),
        )
    return table


def _percent(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.3g}"
