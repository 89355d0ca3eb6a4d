"""The models of the paper's table 1, and ours: fitted to rows, they predict others."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from residual.calibration.choice import (
    Training,
    choice_groups,
    chosen_lookup,
    corrected,
    fixed_lookup,
)
from residual.recording import Array
from residual.tables.components import fit_pls
from residual.tables.form import PAIR_FORM, EffectForm, Option, fit_linear
from residual.tables.nominal_choice import ChosenLevels, choose_levels
from residual.tables.nominal_pls import (
    NominalForm,
    NominalPls,
    fill_unvisited,
    fit_nominal_pls,
)

NONE, LS, PLSR, PAPER_FORM, DEFAULT = "none", "ls", "plsr", "paper", "default"
CHOSEN, SPARSE = "chosen", "sparse"
EFFECTS = "effects"
WORDS = {
    NONE: "no compensation",
    LS: "LS",
    PLSR: "PLSR",
    PAPER_FORM: "paper form, dense",
    SPARSE: "paper form, sparse",
    CHOSEN: "paper form, levels chosen",
    DEFAULT: "default form",
    EFFECTS: "named effects",
}


# Corrections of rows by every choice, such as component counts. Shape (c, m, j).
Forecast = Callable[[Training], Array]
Method = Callable[[Training], Forecast]


@dataclass(frozen=True, slots=True)
class Forms:
    """What models may be chosen from.

    Attributes:
        default: Parts of the default form.
        paper: Levels and components of the paper's form.
        levels: Numbers of levels to choose from; empty where they are given.
    """

    default: EffectForm
    paper: NominalForm
    levels: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Choices:
    """What was chosen on all rows.

    Attributes:
        options: Options of the default form, a joint each.
        levels: Levels and components of the paper's form; None where they are given.
    """

    options: tuple[Option, ...]
    levels: ChosenLevels | None = None


def methods(forms: Forms, fixed: Choices | None = None) -> Mapping[str, Method]:
    """Return every model by name.

    What was chosen is fixed, or None to choose within the training rows. All are taught
    by the same rows (`Training.taught`).
    """
    sparse = replace(forms.paper, sparsity=PAIR_FORM.sparsity)

    def default(training: Training) -> Forecast:
        if fixed is None:
            lookup = chosen_lookup(training, forms.default)
        else:
            lookup = fixed_lookup(training, forms.default, fixed.options)
        return lambda rows: corrected(lookup, rows)[None]

    def levels(training: Training) -> Forecast:
        chosen = fixed.levels if fixed else levels_of(training, forms)
        model, count = fit_chosen(training, chosen)
        return lambda rows: model.predict(rows.X, count)[None]

    others = {
        NONE: _nothing,
        LS: _least_squares,
        PLSR: _plsr,
        PAPER_FORM: lambda training: _nominal(training, forms.paper),
        SPARSE: lambda training: _nominal(training, sparse),
        **({CHOSEN: levels} if forms.levels else {}),
    }
    return {name: _taught(method) for name, method in others.items()} | {
        # It leaves out some more parts, and is taught by the others.
        DEFAULT: default
    }


def _taught(method: Method) -> Method:
    return lambda training: method(training.taught())


def levels_of(training: Training, forms: Forms) -> ChosenLevels:
    """Levels and components of the paper's form, chosen on runs left out."""
    data = (training.X, training.Y, choice_groups(training), training.tau)
    return choose_levels(*data, forms.paper, forms.levels)


def fit_chosen(training: Training, chosen: ChosenLevels) -> tuple[NominalPls, int]:
    """The paper's form as chosen, unvisited cells filled, and its components."""
    model = fill_unvisited(
        fit_nominal_pls(training.X, training.Y, chosen.form, fewer=True)
    )
    return model, min(chosen.components, model.components)


def _nothing(training: Training) -> Forecast:
    return lambda rows: np.zeros((1, *rows.Y.shape))


def _least_squares(training: Training) -> Forecast:
    fits = [
        fit_linear(training.X[moves], training.Y[moves][:, [j]])
        for j, moves in enumerate(training.counted.T)
    ]
    offset, slope = (np.concatenate(part, axis=-1) for part in zip(*fits, strict=True))
    return lambda rows: (offset + rows.X @ slope)[None]


def _plsr(training: Training) -> Forecast:
    model, most = fit_pls(training.X, training.Y), training.X.shape[1]
    return lambda rows: _by_count(
        model.transform(rows.X), model.Q.T, model.y_mean, most
    )


def _nominal(training: Training, form: NominalForm) -> Forecast:
    model = fit_nominal_pls(training.X, training.Y, form, fewer=True)
    Q = model.Q * model.y_scale
    return lambda rows: _by_count(
        model.transform(rows.X), Q, model.y_mean, form.components
    )


def _by_count(T: Array, Q: Array, mean: Array, most: int) -> Array:
    """Predictions of 0 to `most` components; where there are fewer, the last again."""
    out = np.empty((most + 1, len(T), len(mean)))
    out[0] = mean
    for a in range(most):
        out[a + 1] = out[a]
        if a < T.shape[1]:
            out[a + 1] += np.outer(T[:, a], Q[a])
    return out
