"""Experiments in the terminal: validations, and drives by a model."""

from flows.report.document import Table
from flows.steps.track import LOOP, MODEL, NOMINAL, Gain, Tracked
from flows.steps.validate import Validation

# The 2 x 2 design and computed torque: what stands in a row, and its name.
_CELLS = {
    "rigid body": ", neither",
    "+ acceleration": ", no effects",
    "+ friction and effects": ", no acceleration",
    "+ both": "",
    "computed torque": LOOP,
}
_UNITS = {"rms": (1e3, "mrad"), "peak": (1e3, "mrad"), "chatter": (1, "N m")}


def validation(made: Validation) -> Table:
    """Return the errors of a validation, a joint a row."""
    columns = {
        "open loop\n[mrad]": made.open_loop,
        "feed-forward,\nnominal [mrad]": made.nominal,
        "feed-forward, the\narm's own [mrad]": made.arm,
    }
    columns = {title: c for title, c in columns.items() if c is not None}
    rows = [
        (str(joint), *(f"{1e3 * value:.2f}" for value in row))
        for joint, row in enumerate(zip(*columns.values(), strict=True), 1)
    ]
    return Table(("joint", *columns), rows, left=())


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


def tracking(made: Tracked) -> list[str | Table]:
    """Return drives by a model: the 2 x 2 design, joint by joint, what it gains."""
    pairs = [(NOMINAL, MODEL, "rms"), (NOMINAL, MODEL, "peak")]
    pairs += [(NOMINAL + LOOP, MODEL + LOOP, "rms")]
    pairs += [
        (f"{MODEL}{less}", MODEL, "rms")
        for less in (", no effects", ", no acceleration")
    ]
    gains = [_gain(made.gain(*pair)) for pair in pairs]
    return [_cells(made), _joints(made), *gains]


def _cells(made: Tracked) -> Table:
    """What each cell leaves, all joints and motions together."""
    measures = (("rms", 2), ("peak", 1), ("chatter", 3), ("energy", 0))
    rows = []
    for words, cell in _CELLS.items():
        row = [words]
        for what, digits in measures:
            scale = _UNITS.get(what, (1, ""))[0]
            both = (_mean(made, name + cell, what) for name in (NOMINAL, MODEL))
            row.append(" → ".join(f"{scale * value:.{digits}f}" for value in both))
        rows.append(row)
    titles = ("rms [mrad]", "peak [mrad]", "chatter [N m]", "energy [J]")
    heads = [f"nominal → model\n{title}" for title in titles]
    return Table(("torque by the model's", *heads), rows)


def _joints(made: Tracked) -> Table:
    """Root mean square and peak per joint, all of each model fed forward."""
    columns = [
        1e3 * _joined(made.values(name, what), what)
        for what in ("rms", "peak")
        for name in (NOMINAL, MODEL)
    ]
    rows = [
        (str(joint), *(f"{value:.2f}" for value in row))
        for joint, row in enumerate(zip(*columns, strict=True), 1)
    ]
    model = "model [mrad]"
    return Table(
        ("joint", "rms, nominal", model, "peak, nominal", model), rows, left=()
    )


def _gain(gain: Gain) -> str:
    scale, unit = _UNITS[gain.what]
    interval = "a single motion, so no interval"
    if gain.low == gain.low:
        low, high = scale * gain.low, scale * gain.high
        interval = f"95 % {low:+.3g} to {high:+.3g}, {gain.n} motions"
    return (
        f"{gain.what}, {gain.second} for {gain.first}: {gain.ratio:.2f} times, "
        f"{scale * gain.change:+.3g} {unit} ({interval})"
    )


def _mean(made: Tracked, cell: str, what: str) -> float:
    values = made.values(cell, what)
    if what == "energy":
        return float(values.sum(axis=1).mean())
    if what == "peak":
        return float(values.max())
    return float((values**2).sum(axis=1).mean() ** 0.5)


def _joined(values, what: str):
    return values.max(axis=0) if what == "peak" else (values**2).mean(axis=0) ** 0.5
