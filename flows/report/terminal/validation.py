"""A validation in the terminal: errors per joint, and what they mean."""

from rich.box import SIMPLE_HEAD
from rich.table import Table

from flows.steps.validate import Validation


def meaning(made: Validation) -> str:
    """Return what a validation shows, in one sentence."""
    worst = int(made.open_loop.argmax())
    told = (
        f"Under the logged torque the nominal model strays, within {made.window:g} s, "
        f"by {1e3 * made.open_loop[worst]:.3g} mrad on joint {worst + 1}, the worst"
    )
    if made.nominal is None:
        return f"{told}."
    # The joint with most to gain in angle, not in proportion: where errors are tiny, a
    # large factor between them says little.
    most = int((made.nominal - made.arm).argmax())
    nominal, arm = 1e3 * made.nominal[most], 1e3 * made.arm[most]
    if nominal < 1.1 * arm:
        return (
            f"{told}; as feed-forward its torque tracks about as well as the arm's own."
        )
    return (
        f"{told}; its torque as feed-forward leaves {nominal:.3g} mrad on joint "
        f"{most + 1} where the arm's own leaves {arm:.3g}: about the "
        "difference is what a better model can gain."
    )


def validation_table(made: Validation) -> Table:
    """Return the errors, a joint a row."""
    columns = {
        "open loop\n\\[mrad]": made.open_loop,
        "feed-forward,\nnominal \\[mrad]": made.nominal,
        "feed-forward, the\narm's own \\[mrad]": made.arm,
    }
    columns = {title: c for title, c in columns.items() if c is not None}
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for title in ("joint", *columns):
        table.add_column(title, justify="right")
    for joint, row in enumerate(zip(*columns.values(), strict=True), 1):
        table.add_row(str(joint), *(f"{1e3 * value:.2f}" for value in row))
    return table
