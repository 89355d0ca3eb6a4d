"""Drives by a model in the terminal: the 2 x 2 design, joints, and what it gains."""

from rich.box import SIMPLE_HEAD
from rich.table import Table

from flows.steps.loop.track import LOOP, MODEL, NOMINAL, Gain, Tracked

_ROWS = {
    "rigid body": ", neither",
    "+ acceleration": ", no effects",
    "+ friction and effects": ", no acceleration",
    "+ both": "",
    "computed torque": LOOP,
}
_UNITS = {"rms": (1e3, "mrad"), "peak": (1e3, "mrad"), "chatter": (1, "N m")}


def cells_table(made: Tracked) -> Table:
    """Return what each cell leaves, all joints and motions together."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("torque by the model's")
    for title in ("rms \\[mrad]", "peak \\[mrad]", "chatter \\[N m]", "energy \\[J]"):
        table.add_column(f"nominal → model\n{title}", justify="right")
    for words, cell in _ROWS.items():
        row = []
        for what, digits in (("rms", 2), ("peak", 1), ("chatter", 3), ("energy", 0)):
            scale = _UNITS.get(what, (1, ""))[0]
            both = (_mean(made, name + cell, what) for name in (NOMINAL, MODEL))
            row.append(" → ".join(f"{scale * value:.{digits}f}" for value in both))
        table.add_row(words, *row)
    return table


def joints_table(made: Tracked) -> Table:
    """Return root mean square and peak per joint, all of each model fed forward."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    titles = ("joint", "rms, nominal", "model \\[mrad]", "peak, nominal")
    for title in (*titles, "model \\[mrad]"):
        table.add_column(title, justify="right")
    columns = [
        1e3 * _joined(made.values(name, what), what)
        for what in ("rms", "peak")
        for name in (NOMINAL, MODEL)
    ]
    for joint, row in enumerate(zip(*columns, strict=True), 1):
        table.add_row(str(joint), *(f"{value:.2f}" for value in row))
    return table


def lines(made: Tracked) -> list[str]:
    """Return what is gained, in pairs, a line each."""
    wanted = [made.gain(NOMINAL, MODEL, what) for what in ("rms", "peak")]
    wanted.append(made.gain(NOMINAL + LOOP, MODEL + LOOP))
    wanted += [made.gain(f"{MODEL}, no effects", MODEL)]
    wanted += [made.gain(f"{MODEL}, no acceleration", MODEL)]
    return [_line(gain) for gain in wanted]


def _line(gain: Gain) -> str:
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
