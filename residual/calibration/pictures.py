"""What the paper's figures 7 to 9 show: corrections over time, scores and loadings."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from residual.calibration.methods import (
    CHOSEN,
    DEFAULT,
    LS,
    PAPER_FORM,
    Choices,
    Forms,
    Training,
    methods,
)
from residual.calibration.rows import Rows
from residual.calibration.scores import RUN, Response, Scheme
from residual.recording import Array
from residual.tables.pls import fit_pls

_SHOWN = (LS, PAPER_FORM, CHOSEN, DEFAULT)
_MOST = 600  # rows of a picture
_STRONG = 0.5  # correlation from which a variable is said to make a component
_PLANE = 2


@dataclass(frozen=True, eq=False, slots=True)
class Unseen:
    """A run that no model has seen, over time (paper, figure 9).

    Attributes:
        label: The run.
        t: Time from its first row [s]. Shape (n,).
        left: What the nominal model leaves: the measured residual [N m]. Shape (n, j).
        corrections: Torque of each model's correction [N m]. Shapes (n, j).
    """

    label: str
    t: Array
    left: Array
    corrections: Mapping[str, Array]


@dataclass(frozen=True, eq=False, slots=True)
class Plane:
    """Scores and loadings of the first two components of PLSR.

    Loadings are correlations with the scores: on the circle a variable is all in the
    plane, at its middle it has no part in it.

    Attributes:
        names: Variables, then residuals of the joints.
        loadings: Correlations. Shape (variables + j, 2).
        explained: Share of the residuals' variance per component [%]. Shape (2,).
        scores: Some of the rows. Shape (n, 2).
        run: Run of each. Shape (n,).
    """

    names: tuple[str, ...]
    loadings: Array
    explained: Array
    scores: Array
    run: Array

    def strong(self, component: int) -> tuple[tuple[str, float], ...]:
        """Variables and residuals that make a component, the strongest first."""
        column = self.loadings[:, component]
        order = np.argsort(-np.abs(column), kind="stable")
        kept = [i for i in order if abs(column[i]) >= _STRONG]
        return tuple((self.names[i], float(column[i])) for i in kept)


def unseen_run(
    rows: Training,
    about: tuple[Rows, Scheme],
    forms: Forms,
    chosen: Choices,
    response: Response,
) -> Unseen:
    """Correct the run of the middle error by models that were fitted without it.

    Args:
        about: The rows with their labels, and the scheme that leaves runs out.
        forms: What models may be chosen from.
        chosen: What was chosen on all rows: the choice, unlike the fit, has seen it.
        response: What a nominal model leaves that was identified without some parts.
    """
    whole, scheme = about
    runs = range(len(whole.labels))
    size = [float((rows.Y[rows.run == run] ** 2).mean()) for run in runs]
    number = int(np.argsort(size)[len(size) // 2])
    held = scheme.folds.of_row == number
    Y = response(scheme.left_out[number])
    told = Training(rows.X, Y, rows.run, rows.tau, rows.part)
    fitted, new = told.rows(~held), told.rows(held)
    step = max(1, int(held.sum()) // _MOST)
    models = methods(forms, chosen)
    corrections = {}
    for name in (n for n in _SHOWN if n in models):
        # All components that there are; of models without a number there is one.
        corrections[name] = models[name](fitted)(new)[-1][::step]
    t = np.arange(int(held.sum())) / whole.rates[number]
    return Unseen(whole.labels[number], t[::step], Y[held][::step], corrections)


def plane_of(rows: Training, names: tuple[str, ...], joints: tuple[int, ...]) -> Plane:
    """Scores and loadings of PLSR on all rows (paper, section 5)."""
    model = fit_pls(rows.X, rows.Y, names=names)
    T = model.T[:, :_PLANE]
    if T.shape[1] < _PLANE:
        T = np.column_stack([T, np.zeros(len(T))])
    both = np.column_stack([rows.X, rows.Y])
    both = both - both.mean(axis=0)
    length = np.linalg.norm(both, axis=0)[:, None] * np.linalg.norm(T, axis=0)
    loadings = both.T @ T / np.maximum(length, 1e-300)
    Y = rows.Y - rows.Y.mean(axis=0)
    fitted = ((Y.T @ T) ** 2).sum(axis=0) / np.maximum((T**2).sum(axis=0), 1e-300)
    explained = 100 * fitted / max(float((Y**2).sum()), 1e-300)
    step = max(1, len(T) // _MOST)
    residuals = tuple(f"residual{j}" for j in joints)
    parts = T[::step], rows.run[::step]
    return Plane((*names, *residuals), loadings, explained, *parts)


def find_runs(schemes: tuple[Scheme, ...]) -> Scheme | None:
    """The scheme that leaves one run out, None where there is none."""
    return next((scheme for scheme in schemes if scheme.name == RUN), None)
