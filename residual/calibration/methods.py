"""The models of the paper's table 1, and ours: fitted to rows, they predict others."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.recording import Array
from residual.tables.choose import (
    PROVEN,
    EffectModel,
    build_lookup,
    fit_effect_tables,
    of_joints,
)
from residual.tables.components import fit_pls
from residual.tables.form import (
    LEAST_SQUARES,
    EffectForm,
    Option,
    fit_base,
    fit_linear,
    fit_rest,
)
from residual.tables.form import NONE as NOTHING
from residual.tables.lookup import Lookup
from residual.tables.nominal_choice import ChosenLevels, choose_levels
from residual.tables.nominal_pls import (
    NominalForm,
    NominalPls,
    fill_unvisited,
    fit_nominal_pls,
)

NONE, LS, PLSR, PAPER_FORM, DEFAULT = "none", "ls", "plsr", "paper", "default"
CHOSEN = "chosen"
EFFECTS = "effects"
WORDS = {
    NONE: "no compensation",
    LS: "LS",
    PLSR: "PLSR",
    PAPER_FORM: "paper form",
    CHOSEN: "paper form, levels chosen",
    DEFAULT: "default form",
    EFFECTS: "named effects",
}


@dataclass(frozen=True, eq=False, slots=True)
class Training:
    """Rows to fit.

    Attributes:
        X: States. Shape (n, d).
        Y: What the nominal model leaves [N m]. Shape (n, j).
        run: Run of each row. Shape (n,).
        tau: Measured torque [N m]. Shape (n, j).
        part: Part of each row, a block of its run. Shape (n,).
        without: What a nominal model leaves on these rows that has not seen some more
            parts; None where Y does not depend on the rows.
    """

    X: Array
    Y: Array
    run: Array
    tau: Array
    part: Array
    without: Callable[[Collection[int]], Array] | None = None

    @property
    def loaded(self) -> Array:
        """States, then what each joint carries by the model [N m]. Shape (n, d + j)."""
        return np.hstack([self.X, self.tau - self.Y])

    def rows(self, chosen: Array) -> "Training":
        """Return some of the rows."""
        parts = (self.X, self.Y, self.run, self.tau, self.part)
        return Training(*(part[chosen] for part in parts))


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

    What was chosen is fixed, or None to choose within the training rows.
    """

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

    return {
        NONE: _nothing,
        LS: _least_squares,
        PLSR: _plsr,
        PAPER_FORM: lambda training: _nominal(training, forms.paper),
        **({CHOSEN: levels} if forms.levels else {}),
        DEFAULT: default,
    }


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


def corrected(lookup: Lookup, rows: Training) -> Array:
    """Corrections by tables that may need loads. Shape (m, j)."""
    return lookup.predict(rows.loaded[:, : len(lookup.names)])


def chosen_lookup(training: Training, form: EffectForm) -> Lookup:
    """The default form, its options chosen on runs left out of these rows."""
    model, options = chosen_model(training, form)
    if options == model.chosen:
        return model.lookup
    return build_lookup(model.base, model.rest, options, form)


def chosen_model(
    training: Training, form: EffectForm
) -> tuple[EffectModel, tuple[Option, ...]]:
    """The default form with the options that stand up to a nominal model of others.

    What a model leaves on runs that it was identified from is smaller, and of another
    shape, than what it leaves on others. So a choice is confirmed run by run: the
    nominal model and the tables of all other runs must leave less than that nominal
    model alone. A joint that fails gets nothing.

    Of fewer than three runs blocks are left out instead. Blocks do not show what
    happens outside the range of their own runs: so least squares, which has no bound
    there, is not taken, and of two runs each must be helped by the other one alone.
    """
    groups = choice_groups(training)
    X = training.loaded if form.loads else training.X
    model = fit_effect_tables(X, training.Y, groups, training.tau, form)
    options = tuple(_bounded(o, training) for o in model.chosen)
    good = np.ones(len(options), bool)
    if training.without is not None:
        good = _gains(training, groups, form, options).sum(axis=0) > 0
    if len(np.unique(training.run)) == PROVEN - 1:
        good &= (_gains(training, training.run, form, options) > 0).all(axis=0)
    kept = zip(options, good, strict=True)
    return model, tuple(option if ok else Option(NOTHING) for option, ok in kept)


def _bounded(option: Option, training: Training) -> Option:
    few = len(np.unique(training.run)) < PROVEN
    return Option(NOTHING) if few and option.kind == LEAST_SQUARES else option


def _gains(
    training: Training, groups: Array, form: EffectForm, options: Sequence[Option]
) -> Array:
    """Drop of the squared rest of each group by tables of the others. (groups, j)."""
    gains = []
    for label in np.unique(groups):
        held = groups == label
        Y = training.Y
        if training.without is not None:
            Y = training.without(np.unique(training.part[held]).tolist())
        rows = replace(training, Y=Y, without=None)
        lookup = fixed_lookup(rows.rows(~held), form, options)
        rest = Y[held] - corrected(lookup, rows.rows(held))
        gains.append((Y[held] ** 2).sum(axis=0) - (rest**2).sum(axis=0))
    return np.array(gains)


def choice_groups(training: Training) -> Array:
    """Runs to choose by; their blocks where runs are fewer than three. Shape (n,)."""
    few = len(np.unique(training.run)) < PROVEN
    return training.part if few else training.run


def fixed_lookup(
    training: Training, form: EffectForm, options: Sequence[Option]
) -> Lookup:
    """The default form with its options given: nothing is chosen on these rows."""
    X = training.loaded if form.loads else training.X
    base = fit_base(X, training.Y, form)
    ridges = [form.ridges.index(o.ridge or form.ridges[-1]) for o in options]
    left = training.Y - of_joints(base.predict(X, form)[1], ridges)
    rest = fit_rest(X, left, choice_groups(training), form, options)
    return build_lookup(base, rest, options, form)


def _nothing(training: Training) -> Forecast:
    return lambda rows: np.zeros((1, *rows.Y.shape))


def _least_squares(training: Training) -> Forecast:
    offset, slope = fit_linear(training.X, training.Y)
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
