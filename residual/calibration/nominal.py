"""The nominal model without some of the runs, alone as all that identifies anew here.

A correction that is judged on unseen runs must start from a model that has not seen
them either. The model is the program's own "identified": declared effects and rigid
body under a prior whose width the logs choose (docs/method.md); effects that a
diagnosis named can be added, and all are fitted together.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from residual.calibration.rows import (
    Part,
    Run,
    chosen_rows,
    cut_parts,
    folds_without,
    label_rows,
    torque_at,
    tracks_without,
)
from residual.evidence.design import Design
from residual.evidence.fit import as_model, fit, start
from residual.evidence.priors import priors
from residual.model.model import Model, Term
from residual.model.nominal import (
    Logs,
    Nominal,
    declared_names,
    prepare_logs,
    start_nominal,
    with_standstill,
)
from residual.recording import Array
from residual.robot.robot import Robot
from residual.signals.splitting import spread
from residual.signals.track import Filters, Track


@dataclass(frozen=True, eq=False, slots=True)
class Prepared:
    """All logs, ready for as many identifications as there are folds.

    Attributes:
        logs: Signals and the range of motion.
        runs: The logs behind them.
        nominal: Where every identification starts.
        parts: Blocks of the logs, which identifications may leave out.
        design: Columns of the nominal model; its folds are those of ``label_rows``.
    """

    logs: Logs
    runs: tuple[Run, ...]
    nominal: Nominal
    parts: tuple[Part, ...]
    design: Design

    @property
    def names(self) -> tuple[str, ...]:
        """Declared effects."""
        return self.nominal.names

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Signals of each log."""
        return self.logs.tracks

    def residuals(self, model: Model) -> tuple[Array, ...]:
        """Measured minus model torque on each log's track [N m]. Shapes (n, dof)."""
        out = []
        for run, track in zip(self.runs, self.tracks, strict=True):
            torque = model.torque_on(track)
            out.append(torque_at(run.log, track) - torque)
        return tuple(out)


def prepare_runs(
    robot: Robot, runs: Sequence[Run], declared: Sequence[str] | None
) -> Prepared:
    """Filter all logs once; declared effects are the robot's own list for None."""
    logs = prepare_logs(robot, [run.log for run in runs], None, Filters(), whole=True)
    nominal = start_nominal(logs, declared_names(robot, declared))
    parts = cut_parts([track.t[chosen_rows(track)] for track in logs.tracks])
    labels = label_rows(logs.tracks, parts)
    design = Design(logs.tracks, nominal.model, labels=labels)
    return Prepared(logs, tuple(runs), nominal, parts, design)


def identified_without(
    prepared: Prepared, left_out: Collection[int] = (), named: Sequence[Term] = ()
) -> Model:
    """Identify the model from all parts of the runs but some, by number.

    Coefficients of named effects, beyond the declared ones, are fitted too.
    """
    design, nominal, parts = prepared.design, prepared.nominal, prepared.parts
    if left_out:
        folds = folds_without(parts, left_out)  # a last edge may have no rows
        design = design.part(folds[folds < design.folds], alone=True)
    wide, size = priors(design, nominal), design.size
    first = start(design, wide[-1])
    if named:
        # Some effects read the model's own torque: it should be about right.
        design.show_torque(as_model(nominal, first))
    groups = design.add([(t.effect, t.joints, t.shape) for t in named])
    fits = [fit(design, p, groups, first.counted, None, rounds=4) for p in wide]
    best = as_model(nominal, max(fits, key=lambda f: f.score))
    design.take_back(size)
    tracks = tracks_without(prepared.tracks, parts, left_out)
    shown = spread([track.seconds for track in tracks])
    return with_standstill(best, [tracks[i] for i in shown])
