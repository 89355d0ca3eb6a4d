"""What a query needs that is damaged."""

from collections.abc import Iterable

from warehouse.kinds import KINDS
from warehouse.schema import VIEWS


def _feeding(view: str) -> tuple[str, ...]:
    """Return the kinds of record that a view is made of."""
    if view in ("samples", "channels"):
        return ("runs",)
    if view == "verdicts":
        return ("diagnoses", "runs")
    if view == "adopted":
        return ("adoptions",)
    return tuple(k.name for k in KINDS.values() if view in (k.name, *k.lists))


# Kinds of record that each view is made of.
FED_BY = {view: _feeding(view) for view in (*VIEWS, "samples", "channels")}


def needs_damaged(lines: Iterable[str]) -> str:
    """Return what to say of an answer that would need what is damaged."""
    told = list(lines)
    more = f" And {len(told) - 3} more." if len(told) > 3 else ""
    return (
        f"The answer needs what is damaged. {' '.join(told[:3])}{more} Or ask without "
        "it: --without-damaged."
    )
