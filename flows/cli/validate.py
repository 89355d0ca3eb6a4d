"""modelgap validate: how far the nominal model gets by itself on a run."""

from flows.say import say


def validate(run: str, /, *, window: float = 0.25, store: str | None = None) -> None:
    """Try the nominal model on a run of the store, without fitting anything.

    ```
    modelgap validate 3f2a
    modelgap validate 3f2a --window 0.1
    ```

    Open loop: under the logged torque alone, window by window, how far does the model
    stray from what was measured? Feed-forward, on simulated runs: driven by the
    model's torque, how well does the arm track its reference, and how well when
    driven by its own? Root mean square per joint; the store keeps it.

    Args:
        run: Id of a run; the beginning is enough.
        window: Length of the windows in seconds; errors grow quickly with it.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    from rich.console import Console

    from flows.settings import store_folder
    from flows.steps import validate as steps

    place, console = store_folder(store), Console()
    id, made = steps.validate(run, window, place)
    console.print(_table(made))
    stored = f"stored in {place}: modelgap show {id}"
    say(console, meaning(made), *made.notes, stored)


def meaning(made) -> str:
    """Return what a validation shows, in one sentence.

    Args:
        made: A ``flows.steps.validate.Validation``.
    """
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
        return f"{told}; as feed-forward its torque is about as good as the arm's own."
    return (
        f"{told}; its torque as feed-forward leaves {nominal:.3g} mrad on joint "
        f"{most + 1} where the arm's own leaves {arm:.3g}: about the "
        "difference is what a better model can gain."
    )


def _table(made):
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

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
