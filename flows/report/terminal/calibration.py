"""A calibration in the terminal: errors by scheme and model, and what they say."""

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from flows.outputs import say
from flows.report.words.calibration import sentences
from flows.steps.calibrate import Calibrated
from residual.calibration.calibrate import Calibration
from residual.calibration.methods import WORDS as MODELS
from residual.calibration.rows import PAPER
from residual.calibration.scores import WORDS as SCHEMES
from residual.calibration.scores import Score
from residual.tables.form import NAMED, PAIRS


def print_outcome(outcome: Calibrated, console: Console) -> None:
    """Print the table, and what it shows.

    Args:
        outcome: The calibration.
    """
    if not console.is_terminal:
        # Into a file or a pipe: as wide as it needs, nothing is cut.
        console = Console(file=console.file, width=200)
    console.print(_table(outcome.made))
    lines = [
        about_rows(outcome.made),
        chosen_words(outcome.made),
        *filter(None, [level_words(outcome.made)]),
        *sentences(outcome.made),
    ]
    lines += [f"note: {n}" for n in outcome.made.notes]
    lines += [f"warning: {w}" for w in outcome.warnings]
    say(console, *lines)


def about_rows(made: Calibration) -> str:
    """Return in a sentence what X and Y are, so that the errors can be read."""
    rows = made.rows
    common = f"{len(rows.X)} rows of {len(rows.labels)} runs; errors are per cent of "
    common += "the measured torque"
    if rows.mode == PAPER:
        joints = ", ".join(map(str, rows.joints))
        return (
            f"X: reference of joints {joints} and its derivatives; Y: torque minus "
            f"that of the simulated twin, one sample ahead; {common}."
        )
    declared = ", ".join(made.declared) or "nothing"
    return (
        "X: measured motion of all joints; Y: torque minus that of a model (declared: "
        f"{declared}) identified without the held-out runs; {common}."
    )


def chosen_words(made: Calibration) -> str:
    """Return in a sentence what the default form takes for each joint."""
    taken = []
    for joint, option in zip(made.rows.joints, made.chosen, strict=True):
        what = option.kind
        if option.kind == NAMED:
            what = f"main effects and {option.count} pair table(s)"
        elif option.kind == PAIRS:
            what = f"main effects and all pairs, {option.count} component(s)"
        taken.append(f"J{joint} {what}")
    where = "runs" if made.proven else "blocks of the runs, which are fewer than three,"
    return f"default form, chosen on {where} left out: {'; '.join(taken)}."


def level_words(made: Calibration) -> str | None:
    """Return in a sentence which levels the paper form takes; None where given."""
    if made.levels is None:
        return None
    form, names = made.levels.form, made.rows.names
    pairs = zip(names, form.levels, strict=True)
    return (
        f"paper form, levels chosen on runs left out: {made.levels.components} "
        f"component(s), levels {', '.join(f'{n} {k}' for n, k in pairs)}; cells that "
        "no row visited are filled from coarser levels."
    )


def _table(made: Calibration) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    paper = made.rows.mode == PAPER
    titles = [f"J{j}" for j in made.rows.joints]
    heads = ["RMSEV (RMSEC) \\[%]", "model", *titles, "all"]
    heads += [f"mean {t}" for t in titles] if paper else []
    for i, title in enumerate(heads):
        table.add_column(title, justify="left" if i < 2 else "right", no_wrap=True)
    before = None
    for one in made.scores:
        if before not in (None, one.scheme):
            table.add_section()
        name = SCHEMES[one.scheme] if one.scheme != before else ""
        before = one.scheme
        cells = [
            f"{_percent(v)} ({_percent(c)})"
            for v, c in zip(one.rmsev, one.rmsec, strict=True)
        ]
        means = [_percent(m) for m in one.mean] if paper else []
        table.add_row(name, _model(one), *cells, _percent(one.overall), *means)
    return table


def _model(one: Score) -> str:
    words = MODELS[one.model]
    return words if one.components is None else f"{words}, A = {one.components}"


def _percent(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.1f}"
