"""Group measured: the data-driven forms on real arms, unseen runs and unseen blocks."""

from pathlib import Path

import numpy as np

from benchmarks.figures import Figures, figure, missing
from benchmarks.measured_parts.arms import data_folder
from residual.calibration.calibrate import Calibration, Settings, calibrate
from residual.calibration.methods import DEFAULT, EFFECTS, NONE, PAPER_FORM
from residual.calibration.rows import Run
from residual.calibration.scores import BLOCK, RUN, UNSEEN, Score, find, ratio_interval
from residual.close import close_the_loop
from residual.model.term import Term
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from warehouse.logs import read_log

NOT_WORSE = 1.03
ARMS = ("kr300", "ur10", "lwr4")
# Of each arm: model, what it is held against, the least ratio that is a failure.
_PAIRS = (
    ("default_over_none", DEFAULT, NONE, NOT_WORSE),
    ("default_over_named", DEFAULT, EFFECTS, None),
    ("paper_form_over_none", PAPER_FORM, NONE, None),
)
_NO_BAR = "for information, no bar of its own"


def measured_figures(quick: bool) -> Figures:
    """Return the figures of the measured arms; all are left to the full run."""
    folder = data_folder()
    why = "the full run measures it"
    if folder is None:
        why = "no measured logs: neither ../shared/data nor $MODELGAP_DATA"
    out: Figures = {}
    for arm in ARMS:
        if quick or folder is None:
            out[f"{arm}_default_over_none"] = missing(NOT_WORSE, why)
            for name, _, _, bar in _PAIRS:
                out[f"{arm}_blocks_{name}"] = missing(bar, why)
            continue
        made = _calibrated(folder / arm)
        out[f"{arm}_default_over_none"] = over_none(made)
        for name, one, other, bar in _PAIRS:
            out[f"{arm}_blocks_{name}"] = _ratio(made, one, other, bar)
        own = [name for name in out if name.startswith(arm)]
        print(*(f"{name}: {out[name]}" for name in own), sep="\n", flush=True)
    return out


def over_none(made: Calibration) -> dict:
    """The default form against no compensation, the worst joint on unseen runs."""
    one, none = (find(made.scores, RUN, model) for model in (DEFAULT, NONE))
    ratios = one.rmsev / none.rmsev
    return figure(
        float(ratios.max()),
        NOT_WORSE,
        len(ratios),
        ratios=rounded(ratios),
        percent=rounded(one.rmsev),
        none_percent=rounded(none.rmsev),
        options=[o.kind for o in made.chosen],
    )


def rounded(values: np.ndarray) -> list[float]:
    """Return numbers as they are recorded."""
    return [round(float(v), 3) for v in values]


def _calibrated(folder: Path) -> Calibration:
    robot = load_robot(folder / f"{folder.name}.urdf")
    logs = [read_log(str(path), robot)[0] for path in sorted(folder.glob("*.csv"))]
    runs = [Run(log) for log in logs]
    settings = Settings(views=False, schemes=UNSEEN)
    return calibrate(robot, runs, settings, _named(robot, logs))


def _named(robot: Robot, logs: list[Recording]) -> tuple[Term, ...]:
    """What a diagnosis of all logs names: its names have seen every block."""
    models = close_the_loop(robot, logs).models
    return models["augmented"].terms[len(models["nominal"].terms) :]


def _ratio(made: Calibration, model: str, other: str, bar: float | None) -> dict:
    """Error of one model over that of another, over all joints, on unseen blocks."""
    # The parts of a single log are its runs here.
    scheme = BLOCK if find(made.scores, BLOCK, NONE) else RUN
    pair = [find(made.scores, scheme, name) for name in (model, other)]
    if None in pair:
        return missing(bar, "the diagnosis names nothing")
    ratio = ratio_interval(*pair, np.random.default_rng(0))
    told = {"interval": rounded([ratio.low, ratio.high]), "joints": _joints(*pair)}
    told |= {"percent": rounded(pair[0].rmsev), "all": round(pair[0].overall, 3)}
    told |= {"other_percent": rounded(pair[1].rmsev)}
    if bar is None:
        told["why"] = _NO_BAR
    return figure(ratio.value, bar, ratio.folds, **told)


def _joints(one: Score, other: Score) -> list[float]:
    return rounded(one.rmsev / other.rmsev)
