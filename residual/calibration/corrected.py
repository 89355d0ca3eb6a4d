"""The tables of a calibration on top of the model that they correct."""

import re

import numpy as np

from residual.calibration.calibrate import Calibration
from residual.calibration.rows import PAPER
from residual.model.corrected import NEAREST, Column, Corrected, Tables
from residual.tables.form import MAIN, NONE
from residual.tables.lookup.lookup import Lookup
from residual.tables.lookup.pack import Axis, Table


def corrected_model(made: Calibration) -> Corrected | None:
    """Return model and tables as one model, which predicts a torque.

    Args:
        made: A calibration.

    Returns:
        The model that was identified from all logs with the tables on top; None where
        they correct a simulated twin, or torque as a sensor reports it.
    """
    model, lookup = made.nominal, made.lookup
    if made.rows.mode == PAPER or model is None:
        return None
    if any(term.effect.of_report for term in model.terms):
        return None
    columns = tuple(map(_column, lookup.names))
    tables = (
        Tables(joint - 1, columns, own, _kind(own), NEAREST)
        for m, joint in enumerate(made.rows.joints)
        if (own := _of_joint(lookup, m))
    )
    return Corrected(model, tuple(tables))


def _kind(lookup: Lookup) -> str:
    empty = not (lookup.tables or lookup.offset.any() or lookup.slope.any())
    return NONE if empty else MAIN


def _column(name: str) -> Column:
    """A variable of the tables as a column of the state: q1, qd1, qdd1, or tau1."""
    on, number, _ = re.split(r"(\d+)", name)
    return ("tau_model" if on == "tau" else on), (int(number) - 1,), ""


def _of_joint(lookup: Lookup, m: int) -> Lookup:
    """The same for one response alone; tables that are zero for it are left out."""
    tables = [
        Table(t.axes, t.values[..., [m]])
        for t in lookup.tables
        if t.values[..., m].any()
    ]
    used = sorted({axis for t in tables for axis in t.axes})
    place = {axis: k for k, axis in enumerate(used)}
    axes: list[Axis] = [lookup.axes[axis] for axis in used]
    moved = [Table(tuple(place[a] for a in t.axes), t.values) for t in tables]
    return Lookup(
        lookup.names,
        (lookup.joints[m],),
        tuple(axes),
        tuple(moved),
        np.array(lookup.offset[[m]]),
        np.array(lookup.slope[:, [m]]),
        lookup.low,
        lookup.high,
    )
