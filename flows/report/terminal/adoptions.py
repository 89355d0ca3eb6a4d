"""Adoptions as text: the list of models of a robot, and what the gate saw."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table

from flows.steps.loop.judge import Judged
from residual.names import joints_listed
from residual.quantity import percent
from warehouse.numbered import Adoption

_HEADS = ("no.", "since", "robot", "model", "held-out error", "what", "who", "note")


def table_of(listed: Sequence[tuple[str, Adoption, str]]) -> Table:
    """Return adoptions as a table.

    Args:
        listed: Number, adoption and time of each, the first one first.
    """
    last = {(made.robot, made.serial): id for id, made, _ in listed}
    table = Table(*_HEADS, box=SIMPLE_HEAD, pad_edge=False)
    for id, made, since in listed:
        now = last[made.robot, made.serial] == id
        table.add_row(
            f"{int(id)}{' *' if now else ''}",
            since,
            " ".join(filter(None, (made.robot, made.serial))),
            made.model_id[:8] if made.model_id else "nominal",
            _errors(made.before, made.after),
            made.action,
            made.who,
            made.note,
        )
    table.caption = "* the model that commands on this store go by"
    return table


def adoption_lines(number: str, judged: Judged) -> list[str]:
    """Return what was adopted, and what the gate saw, a line each."""
    return [
        f"adoption {int(number)}: {judged.model.robot.name} has the model of diagnosis "
        f"{judged.diagnosis[:8]} from now on; modelgap rollback takes it back",
        *seen_lines(judged),
    ]


def seen_lines(judged: Judged) -> list[str]:
    """Return what the gate saw of a model, a line each."""
    lines = [f"against the gate: {doubt}" for doubt in judged.doubts]
    if judged.worth is None:
        return lines
    errors = _errors(judged.worth.before, judged.worth.after)
    lines.append(f"error on held-out motion: {errors}")
    for one in judged.worth.effects:
        where = f" on {joints_listed(one.joints)}" if one.joints else ""
        shown = "is not shown by it"
        if one.part is not None:
            shown = f"is there {one.part:.2f} times"
        lines.append(f"{one.name}{where} {shown}")
    return lines


def _errors(before: float | None, after: float | None) -> str:
    if before is None or after is None:
        return "–"
    return f"{percent(before)} -> {percent(after)}"
