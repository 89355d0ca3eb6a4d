"""What the paper's figures show: components, levels, importance, outliers, one run."""

import tracemalloc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from residual.calibration.choice import Training, fixed_lookup
from residual.calibration.methods import CHOSEN, DEFAULT, LS, PAPER_FORM, Method
from residual.calibration.rows import Rows, Run
from residual.calibration.scores import RANDOM, RUN, Response, Scheme
from residual.recording import Array
from residual.tables.components import (
    fit_pca,
    fit_pls,
    real_components,
    state_block,
    state_names,
)
from residual.tables.crossval import BLOCKS, HeldOut, check_count
from residual.tables.figures import (
    CLASSES,
    Jackknife,
    jackknife,
    nominal_distances,
    speed_classes,
    table_importance,
)
from residual.tables.form import PAIRS, EffectForm, Option
from residual.tables.nominal_choice import SWEEP, nominal_errors
from residual.tables.nominal_pls import NominalForm, fit_nominal_pls

INPUT, TWIN, WHITE = "input", "twin error", "white noise"
LEFT = "residual"
_DRAWS, _MOST_ROWS = 40, 1500  # of surrogates; more rows do not move the limit
_STIFF = 100.0  # ridge of main effects where nothing else was chosen
_SHOWN = (LS, PAPER_FORM, CHOSEN, DEFAULT)
_MOST = 600  # rows of a picture
_STRONG = 0.5  # correlation from which a variable is said to make a component
_PLANE = 2
_TWIN_STATE = ("e_q", "e_qd", "e_qdd")


@dataclass(frozen=True, eq=False, slots=True)
class Components:
    """Principal components of one block of one family (paper, figures 4 to 6).

    Attributes:
        family, block: What it is of.
        explained: Share of the variance per component [%]. Shape (k,).
        limit: What surrogates with the same spectra reach [%]. Shape (k,).
        real, permuted: Components beyond surrogates, and beyond permuted rows.
        first: Variables with the largest loadings of the first component.
    """

    family: str
    block: str
    explained: Array
    limit: Array
    real: int
    permuted: int
    first: tuple[tuple[str, float], ...]


@dataclass(frozen=True, eq=False, slots=True)
class Sweep:
    """Errors over the number of levels (paper, figure 12).

    Attributes:
        levels: Levels tried.
        errors: RMSEV by scheme, best of all component counts [%]. Shapes (levels, j).
        seconds: Processor time of each number of levels [s].
        megabytes: Most memory that its arrays took at once, beside the rows [MB].
    """

    levels: tuple[int, ...]
    errors: Mapping[str, Array]
    seconds: tuple[float, ...]
    megabytes: tuple[float, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Terms:
    """Contributions after main effects, with their run jack-knife.

    Attributes:
        names: Variables, then pairs.
        sizes: Contribution [N m] with standard error. Shapes (terms, j).
        by_rows: The same with random rows left out, as the paper does it: neighbours
            of every row stay, and so do all motions.
    """

    names: tuple[str, ...]
    sizes: Jackknife
    by_rows: Jackknife


@dataclass(frozen=True, eq=False, slots=True)
class Oddities:
    """Outliers of each run in the paper's form, and how far it is from the others.

    Attributes:
        labels: The runs.
        x, y: Share of rows far in the model or off it, and badly predicted for their
            speed.
        by_class: Badly predicted values by speed class. Shape (runs, classes).
        unvisited: Share of its cells that no other run visited.
        outside: Share of rows with a value outside the range of the other runs.
    """

    labels: tuple[str, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]
    unvisited: tuple[float, ...]
    outside: tuple[float, ...]
    by_class: tuple[tuple[float, ...], ...]


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


def components_of(
    rows: Rows, runs: Sequence[Run], rng: np.random.Generator
) -> tuple[Components, ...]:
    """Principal components of input, error and white noise, family by family.

    Where the logs do not say their family, all runs are one.
    """
    out = []
    families = rows.families if all(rows.families) else ("all runs",) * len(runs)
    for family in dict.fromkeys(families):
        members = [i for i, f in enumerate(families) if f == family]
        block = _blocks(rows, runs, members)
        run = block.pop("run")
        block[WHITE] = (rng.normal(size=block[INPUT][0].shape), rows.names)
        for name, (values, names) in block.items():
            out.append(_components(family, name, values, names, run, rng))
    return tuple(out)


def sweep_levels(
    rows: Training,
    schemes: Sequence[Scheme],
    components: int,
    levels: Sequence[int] = SWEEP,
) -> Sweep:
    """Validate every number of levels on unseen runs and on random rows."""
    check_count(min(levels), 2, 4096, "levels", "One cannot tell two states apart.")
    chosen = [s for s in schemes if s.name in (RUN, RANDOM)]
    folds = [s.folds for s in chosen]
    errors: dict[str, list[Array]] = {s.name: [] for s in chosen}
    spent, held_at_once = [], []
    # The compiler's first run is no time of the method.
    few = slice(None, None, max(1, len(rows.X) // 200))
    small = [replace(f, of_row=f.of_row[few]) for f in folds]
    first = NominalForm(levels[0], 1)
    nominal_errors(rows.X[few], rows.Y[few], small, rows.tau[few], first)
    for count in levels:
        form = NominalForm(count, components)
        tracemalloc.start()
        start = process_time()
        made = nominal_errors(rows.X, rows.Y, folds, rows.tau, form)
        spent.append(process_time() - start)
        held_at_once.append(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()
        for scheme, held in zip(chosen, made, strict=True):
            errors[scheme.name].append(_best(held))
    stacked = {name: np.array(values) for name, values in errors.items()}
    return Sweep(tuple(levels), stacked, tuple(spent), tuple(held_at_once))


def terms_of(
    rows: Training,
    form: EffectForm,
    chosen: Sequence[Option],
    rng: np.random.Generator,
) -> Terms:
    """Contribution of every table after main effects, jack-knifed over runs and rows.

    All pair tables are fitted, wanted or not: the question is what each could say.
    """
    form = replace(form, names=form.state_names(), loads=())
    count = form.pairs.components if form.pairs else 0
    ridges = [o.ridge or _STIFF for o in chosen]
    options = [
        Option(PAIRS, r if r in form.ridges else form.ridges[-1], count) for r in ridges
    ]
    whole = table_importance(fixed_lookup(rows, form, options), rows.X)
    none = np.zeros(rows.Y.shape[1])

    def jackknifed(folds: Array) -> Jackknife:
        left_out = []
        for fold in np.unique(folds):
            part = rows.rows(folds != fold)
            found = table_importance(fixed_lookup(part, form, options), part.X)
            left_out.append([found.get(name, none) for name in whole])
        return jackknife(np.array(left_out), np.array([*whole.values()]))

    drawn = rng.permutation(len(rows.X)) % BLOCKS
    return Terms(tuple(whole), jackknifed(rows.run), jackknifed(drawn))


def oddities_of(rows: Training, whole: Rows, form: NominalForm) -> Oddities:
    """Outliers by run, and the share of cells that the other runs never visited."""
    model = fit_nominal_pls(rows.X, rows.Y, form, fewer=True)
    classes = speed_classes(rows.X[:, list(whole.velocities)])
    far = nominal_distances(model, rows.X, rows.Y, classes)
    lean, found = replace(form, components=1), []
    for number in range(len(whole.labels)):
        own = rows.run == number
        others = fit_nominal_pls(rows.X[~own], rows.Y[~own], lean, fewer=True)
        strange = others.levels.outside(rows.X[own]).any(axis=1)
        bad = far.y[own] > far.y_limit
        inside = [classes[own] == kind for kind in range(len(CLASSES))]
        found.append(
            (
                float(far.x_outliers[own].mean()),
                float(far.y_outliers[own].mean()),
                float(others.unvisited_share(rows.X[own]).mean()),
                float(strange.mean()),
                tuple(float(bad[i].mean()) if i.any() else 0 for i in inside),
            )
        )
    return Oddities(whole.labels, *zip(*found, strict=True))


def _blocks(rows: Rows, runs: Sequence[Run], members: Sequence[int]) -> dict:
    """Blocks of some runs with their names, thinned alike."""
    taken = [np.flatnonzero(rows.run == i) for i in members]
    step = max(1, sum(map(len, taken)) // _MOST_ROWS)
    chosen = np.concatenate([part[::step] for part in taken])
    out = {"run": rows.run[chosen], INPUT: (rows.X[chosen], rows.names)}
    if not all(set(_TWIN_STATE) <= set(runs[i].twin) for i in members):
        names = tuple(f"residual{j}" for j in rows.joints)
        return out | {LEFT: (rows.Y[chosen], names)}
    joints, errors = [j - 1 for j in rows.joints], []
    for i, part in zip(members, taken, strict=True):
        # At equally many times as rows were chosen.
        at = np.linspace(0, len(runs[i].log.t) - 1, len(part[::step])).astype(int)
        parts = (runs[i].twin[name][at][:, joints] for name in _TWIN_STATE)
        errors.append(state_block(*parts))
    names = tuple(f"e_{name}" for name in state_names(rows.joints))
    return out | {TWIN: (np.concatenate(errors), names)}


def _components(
    family: str,
    name: str,
    values: Array,
    names: Sequence[str],
    run: Array,
    rng: np.random.Generator,
) -> Components:
    pca = fit_pca(values, names)
    real = real_components(values, rng, run=run, draws=_DRAWS)
    return Components(
        family,
        name,
        100 * pca.explained,
        100 * real.phase_limit / len(names),
        real.count,
        real.permuted,
        pca.strongest(0),
    )


def _best(errors: HeldOut) -> Array:
    curve = errors.pooled()[1:]
    return curve[np.nansum(curve**2, axis=1).argmin()]


def unseen_run(
    rows: Training,
    whole: Rows,
    scheme: Scheme,
    models: Mapping[str, Method],
    response: Response,
) -> Unseen:
    """Correct the run of the middle error by models that were fitted without it.

    They were chosen on all rows: the choice, unlike the fit, has seen the run. The
    scheme leaves runs out.
    """
    runs = range(len(whole.labels))
    size = [float((rows.Y[rows.run == run] ** 2).mean()) for run in runs]
    number = int(np.argsort(size)[len(size) // 2])
    held = scheme.folds.of_row == number
    response_rows = replace(rows, Y=response(scheme.left_out[number]), without=None)
    fitted, new = response_rows.rows(~held), response_rows.rows(held)
    step = max(1, len(new.Y) // _MOST)
    # All components that there are; of models without a number there is one.
    corrections = {
        name: models[name](fitted)(new)[-1][::step] for name in _SHOWN if name in models
    }
    t = np.arange(len(new.Y)) / whole.rates[number]
    return Unseen(whole.labels[number], t[::step], new.Y[::step], corrections)


def plane_of(rows: Training, names: tuple[str, ...], joints: tuple[int, ...]) -> Plane:
    """Scores and loadings of PLSR on all rows (paper, section 5)."""
    T = fit_pls(rows.X, rows.Y, names=names).T[:, :_PLANE]
    T = np.pad(T, ((0, 0), (0, _PLANE - T.shape[1])))
    both = np.column_stack([rows.X, rows.Y])
    both = both - both.mean(axis=0)
    length = np.linalg.norm(both, axis=0)[:, None] * np.linalg.norm(T, axis=0)
    loadings = both.T @ T / np.maximum(length, 1e-300)
    Y = rows.Y - rows.Y.mean(axis=0)
    fitted = ((Y.T @ T) ** 2).sum(axis=0) / np.maximum((T**2).sum(axis=0), 1e-300)
    explained = 100 * fitted / max(float((Y**2).sum()), 1e-300)
    step = max(1, len(T) // _MOST)
    names = (*names, *(f"residual{j}" for j in joints))
    return Plane(names, loadings, explained, T[::step], rows.run[::step])
