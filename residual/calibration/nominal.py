"""The nominal model without some of the runs, alone as all that identifies anew here.

A correction that is judged on unseen runs must start from a model that has not seen
them either. The model is the program's own "identified": declared effects and rigid
body under a prior whose width the logs choose (docs/method.md); effects that a
diagnosis named can be added, and all are fitted together.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from residual.calibration.rows import (
    Blocks,
    Run,
    chosen_rows,
    cut_blocks,
    row_times,
    torque_at,
)
from residual.evidence.design import Design
from residual.evidence.fit import as_model, fit, fit_nominal
from residual.evidence.priors import priors
from residual.model.model import Model
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
class PreparedRuns:
    """All logs, ready for as many identifications as there are folds.

    Attributes:
        logs: Signals and the range of motion.
        runs: The logs behind them.
        nominal: Where every identification starts.
        blocks: Blocks of the logs, which identifications may leave out.
        places: Place of each log's rows in them.
        design: Columns of the nominal model; its folds are those places.
    """

    logs: Logs
    runs: tuple[Run, ...]
    nominal: Nominal
    blocks: Blocks
    places: tuple[Array, ...]
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
) -> PreparedRuns:
    """Filter all logs once; declared effects are the robot's own list for None."""
    logs = prepare_logs(robot, [run.log for run in runs], None, Filters(), split=False)
    nominal = start_nominal(logs, declared_names(robot, declared))
    blocks = cut_blocks([track.t[chosen_rows(track)] for track in logs.tracks])
    numbered = enumerate(map(row_times, logs.tracks))
    places = tuple(blocks.places(run, t) for run, t in numbered)
    design = Design(logs.tracks, nominal.model, labels=list(places))
    return PreparedRuns(logs, tuple(runs), nominal, blocks, places, design)


def identified_without(prepared: PreparedRuns, left_out: Collection[int] = ()) -> Model:
    """Identify the model from all blocks of the runs but some, by number."""
    design, nominal = prepared.design, prepared.nominal
    if left_out:
        folds = prepared.blocks.kept(left_out)  # a last edge may have no rows
        design = design.part(folds[folds < design.folds], alone=True)
    wide = priors(design, nominal)
    first = fit_nominal(design, wide[-1])
    fits = [fit(design, p, (), first.counted, None, rounds=4) for p in wide]
    best = as_model(nominal, max(fits, key=lambda f: f.score))
    tracks = _without(prepared, left_out)
    shown = spread([track.seconds for track in tracks])
    return with_standstill(best, [tracks[i] for i in shown])


def _without(prepared: PreparedRuns, left_out: Collection[int]) -> list[Track]:
    """What is left of each log without some blocks."""
    out = []
    for track, places in zip(prepared.tracks, prepared.places, strict=True):
        kept = prepared.blocks.mask(places, left_out)
        if kept.all():
            out.append(track)
        elif kept.any():
            inner, moving = track.inner & kept, track.moving & kept[:, None]
            out.append(replace(track, inner=inner, moving=moving))
    return out
