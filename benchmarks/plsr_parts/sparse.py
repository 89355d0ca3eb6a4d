"""Group sparse: tables of few cells, and levels chosen on runs left out.

The frozen set is that of the group errors. Levels are chosen on four runs and judged
on four others, against every number of levels and components judged on these others
themselves: the best that hindsight could have taken, and stricter than the sweep that
the choice itself had before it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.figures import Figures, figure, missing
from benchmarks.plsr_parts.paper_set import frozen_runs
from benchmarks.plsr_parts.rows import repeated_rows
from residual.calibration.methods import (
    PAPER_FORM,
    Forms,
    Training,
    chosen_lookup,
    corrected,
    methods,
)
from residual.calibration.rows import Rows, paper_rows
from residual.calibration.scores import relative_error
from residual.recording import Array
from residual.tables.form import PAIR_FORM, EffectForm
from residual.tables.lookup import Lookup
from residual.tables.nominal_choice import SWEEP, choose_levels
from residual.tables.nominal_pls import NominalForm, fill_unvisited, fit_nominal_pls

_WORSE, _SHARE, _NEAR, _BEATS = 1.02, 0.1, 1.01, 0.8
_FRESH = (101, 102, 103)
_PAPER = NominalForm(components=30)
_DENSE = replace(PAIR_FORM, sparsity=0.0)
_COMPONENTS = 15


def sparse_figures(quick: bool) -> Figures:
    """Return the figures; the frozen set is left to the full run."""
    out: Figures = {}
    for side, name in enumerate(("bare", "declared")):
        keys = (f"sparse_{name}_over_better", f"sparse_{name}_cells")
        if quick:
            why = "the full run measures it"
            out |= {
                k: missing(b, why) for k, b in zip(keys, (_WORSE, _SHARE), strict=True)
            }
            continue
        out |= _sparse(paper_rows(frozen_runs(side)), keys)
    ratios = [_chosen_over_best(seed) for seed in _FRESH[: 1 if quick else None]]
    entry = figure(max(ratios), _NEAR, len(ratios), ratios=_rounded(ratios))
    if quick:
        entry |= {"ok": None, "why": "one set; the full run takes three"}
    return out | {"chosen_levels_over_best_of_sweep": entry}


def _sparse(rows: Rows, keys: tuple[str, str]) -> Figures:
    """Unseen-run error of sparse pair tables over that of the better dense form."""
    training = Training(rows.X, rows.Y, rows.run, rows.tau, rows.part)
    loads = tuple((v, len(rows.names) + i) for i, v in enumerate(rows.velocities))
    form = EffectForm(velocities=rows.velocities, loads=loads)
    forms = {"sparse": form, "default": replace(form, pairs=_DENSE)}
    held = [rows.run == run for run in np.unique(rows.run)]
    miss = {name: np.zeros(len(rows.joints)) for name in ("none", *forms)}
    cells = {name: [] for name in forms}
    paper = []
    for out in held:
        kept, new = training.rows(~out), training.rows(out)
        miss["none"] += (new.Y**2).sum(axis=0)
        for name, own in forms.items():
            lookup = chosen_lookup(kept, own)
            miss[name] += ((new.Y - corrected(lookup, new)) ** 2).sum(axis=0)
            cells[name].append(_cells(lookup))
        made = methods(Forms(form, _PAPER))[PAPER_FORM](kept)(new)
        paper.append([((new.Y - one) ** 2).sum(axis=0) for one in made])
    # As the paper takes it: the number of components that does best on these runs.
    curve = np.sum(paper, axis=0)
    miss["paper"] = curve[curve.sum(axis=1).argmin()]
    power = (rows.tau**2).sum(axis=0).sum()
    percent = {k: float(relative_error(m.sum(), power)) for k, m in miss.items()}
    better = min(percent["default"], percent["paper"])
    dense = 36 * 22**2
    told = {"percent": {k: round(v, 3) for k, v in percent.items()}}
    told |= {"joints": _rounded(np.sqrt(miss["sparse"] / miss["default"]))}
    entry = figure(percent["sparse"] / better, _WORSE, len(held), **told)
    if percent["default"] > _BEATS * percent["none"]:
        entry |= {"ok": None, "why": "the default form does not beat none by a fifth"}
    share = max(cells["sparse"]) / dense
    return {keys[0]: entry, keys[1]: figure(share, _SHARE, len(held), **cells)}


def _cells(lookup: Lookup) -> int:
    """Table cells that say something, of all joints together."""
    return sum(int((t.values != 0).any(axis=-1).sum()) for t in lookup.tables)


def _chosen_over_best(seed: int) -> float:
    """Error of the chosen levels on new runs over the least that any would leave."""
    X, Y, run = (part[::4] for part in repeated_rows(seed))
    new, truth, _ = (part[::4] for part in repeated_rows(seed + 1000))
    form = NominalForm(components=_COMPONENTS)
    chosen = choose_levels(X, Y, run, Y, form)
    own = _errors(X, Y, (new, truth), chosen.form)[chosen.components]
    every = [min(_errors(X, Y, (new, truth), replace(form, levels=k))) for k in SWEEP]
    return own / min(every)


def _errors(X: Array, Y: Array, new: tuple, form: NominalForm) -> list[float]:
    """Errors on new rows of 0 to A components."""
    model = fill_unvisited(fit_nominal_pls(X, Y, form))
    counts = range(model.components + 1)
    return [float(np.linalg.norm(new[1] - model.predict(new[0], a))) for a in counts]


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(float(v), 4) for v in values]
