"""How an arm tracks its references by a model: a 2 x 2 design, in pairs.

Friction and effects compensated or not, times torque for the acceleration or not, for
the nominal model and others, on the same motions of the same arm. What differs is
taken motion by motion, with a 95 % interval of Student's t over the motions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
import pyarrow as pa
from cyclopts import Parameter
from scipy import stats

from flows.outputs import Progress
from flows.requests import GivenWords, Request
from flows.settings import store_folder
from flows.specs.experiment import derived_seed
from flows.steps.experiment import torque_of
from flows.steps.models import (
    NOMINAL,
    TABLES,
    model_to_drive,
    nominal_of,
    tables_to_drive,
)
from flows.steps.validate import hidden_plant, robot_of
from residual.errors import InputError
from residual.export.exported import Whole
from residual.lazy import one_blas_thread
from residual.model.control import AS_MEASURED, Turning, Use
from residual.quantity import plain
from residual.robot.robot import Robot
from sim.engine.records import PlantSpec, Reference, TrajectorySpec
from sim.trajectories import make_reference
from sim.twin import Driven, run_along
from warehouse.commit import commit_record
from warehouse.layout import find
from warehouse.runs import read_manifest, read_run
from warehouse.schema import VIEWS, arrow_schema

Array = np.ndarray

KIND, MODEL = "tracking", "model"
# Name of each cell, and what of a model it uses.
CELLS = {
    "": Use(),
    ", no acceleration": Use(acceleration=False),
    ", no effects": Use(effects=False),
    ", neither": Use(effects=False, acceleration=False),
}
LOOP = ", computed torque"
METRICS = {
    "rms": "rms_tracking_q",
    "peak": "peak_tracking_q",
    "chatter": "chatter_tau",
    "energy": "energy",
    "step": "reversal_step_tau",
}


@dataclass(frozen=True, slots=True)
class Track(Request):
    """Which arm is driven by which model, and on which motions.

    Attributes:
        runs: Ids of simulated runs of one arm, whose references are driven.
        model: Id of a diagnosis, a model or a calibration of the store; None for none.
        seeds: With a model: how many further motions of each family to drive.
        encoder_step: With a model: step of the encoders at the joints in rad; with the
            rate of the controller it says over which speed dry friction turns.
        rise: With a model: seconds in which a drive goes from nothing to its torque
            limit; friction turns at that torque rate at most. 0 for none.
        calibration: Id of a calibration, whose tables drive too; None for none.
    """

    runs: GivenWords = ()
    model: Annotated[str | None, Parameter(parse=False)] = None
    seeds: int = 0
    store: Annotated[Path | None, Parameter(parse=False)] = None
    encoder_step: float = AS_MEASURED.encoder_step
    rise: float = AS_MEASURED.rise
    calibration: Annotated[str | None, Parameter(parse=False)] = None


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """A motion to drive: its reference and arm, and the run that it is of, if any."""

    reference: Reference
    plant: PlantSpec
    run_id: str | None


@dataclass(frozen=True, eq=False, slots=True)
class Gain:
    """What differs between two cells, in pairs.

    Attributes:
        what: Which figure, such as "rms".
        first, second: The cells.
        ratio: Second over first, all joints and motions in one norm.
        change: Mean of second minus first over the motions, all joints in one norm.
        low, high: Its 95 % interval; NaN of a single motion.
        n: Motions.
    """

    what: str
    first: str
    second: str
    ratio: float
    change: float
    low: float
    high: float
    n: int


@dataclass(frozen=True, eq=False, slots=True)
class Tracked:
    """All drives.

    Attributes:
        motions: What was driven.
        cells: Drives of each cell, motion by motion; "nominal", "model, no effects"...
        turning: How dry friction turned at reversals.
        width, torque_rate: What came of it: speed over which friction turned [rad/s],
            and torque per second that it was held to [N m/s]. Shapes (dof,).
    """

    motions: tuple[Motion, ...]
    cells: Mapping[str, tuple[Driven, ...]]
    turning: Turning
    width: Array
    torque_rate: Array

    @property
    def names(self) -> tuple[str, ...]:
        """The models that drove, the nominal one first."""
        return tuple(name for name in (NOMINAL, MODEL, TABLES) if name in self.cells)

    def values(self, cell: str, what: str) -> Array:
        """One figure of a cell. Shape (motions, dof)."""
        return np.array([getattr(each, what) for each in self.cells[cell]])

    def gain(self, first: str, second: str, what: str = "rms") -> Gain:
        """Compare two cells motion by motion."""
        one, two = (_whole(self.values(c, what), what) for c in (first, second))
        change = two - one
        half = np.nan
        if len(change) > 1:
            wide = stats.t.ppf(0.975, len(change) - 1)
            half = float(wide * change.std(ddof=1) / np.sqrt(len(change)))
        mean = float(change.mean())
        ratio = float(np.sqrt((two**2).sum() / max((one**2).sum(), 1e-300)))
        ends = mean - half, mean + half
        return Gain(what, first, second, ratio, mean, *ends, len(change))

    @property
    def gains(self) -> tuple[Gain, ...]:
        """The comparisons that are reported, for every figure."""
        _, *others = self.names
        pairs = [
            *((NOMINAL + how, m + how) for m in others for how in ("", LOOP)),
            *((f"{m}, no effects", m) for m in self.names),
            *((f"{m}, no acceleration", m) for m in self.names),
        ]
        return tuple(self.gain(*p, what) for what, p in product(METRICS, pairs))


@one_blas_thread
def track(request: Track, progress: Progress | None = None) -> tuple[str, Tracked]:
    """Drive the arm of simulated runs by the nominal model and others, and keep it.

    Raises:
        InputError: If there is no run, it has no sealed arm, or a model is of
            another robot.
    """
    store = store_folder(request.store)
    if not request.runs:
        raise InputError("No run to drive. Name it: modelgap validate RUN --model ID")
    logs = [read_run(store, run) for run in request.runs]
    manifests = [read_manifest(store, log.id) for log in logs]
    robot = robot_of(logs[0], manifests[0])
    for log, manifest in zip(logs, manifests, strict=True):
        if robot_of(log, manifest).content_hash != robot.content_hash:
            raise InputError("The runs are of several robots; give those of one.")
    motions = _motions(store, robot, manifests, request.runs, request.seeds)
    nominal = nominal_of(robot, logs[:1])
    models: dict[str, Whole] = {NOMINAL: nominal}
    if request.model is not None:
        models[MODEL] = model_to_drive(store, request.model, robot)
    if request.calibration is not None:
        models[TABLES] = tables_to_drive(store, request.calibration, nominal)
    made = tracked(
        robot,
        models,
        motions,
        Turning(request.encoder_step, rise=request.rise),
        progress,
    )
    asked = replace(request, runs=tuple(log.id for log in logs)).to_record()
    for name in ("model", "calibration"):
        asked[name] = None if asked[name] is None else find(store, asked[name]).id
    asked |= {"robot": manifests[0]["robot"], "robot_hash": robot.content_hash}
    return _put(store, robot, asked, made), made


def tracked(
    robot: Robot,
    models: Mapping[str, Whole],
    motions: Sequence[Motion],
    turning: Turning = AS_MEASURED,
    progress: Progress | None = None,
) -> Tracked:
    """Drive every motion in every cell.

    Args:
        models: "nominal" first; "model", "tables" or both.
        turning: How dry friction turns at reversals.
    """
    tell = progress or (lambda stage, share: None)
    cells: dict[str, list[Driven]] = {}
    for i, motion in enumerate(motions):
        for name, model in models.items():
            ways = [(cell, use, "feed_forward") for cell, use in CELLS.items()]
            for cell, use, kind in (*ways, (LOOP, Use(), "computed_torque")):
                use = replace(use, turning=turning)
                given = torque_of(model, motion.reference, kind, use)
                done = run_along(robot, motion.reference, motion.plant, given)
                cells.setdefault(name + cell, []).append(done)
        tell("drive", (i + 1) / len(motions))
    step = motions[0].reference.t[1] - motions[0].reference.t[0]
    came = turning.width(1 / step, robot.dof), turning.torque_rate(robot)
    done = {cell: tuple(drives) for cell, drives in cells.items()}
    return Tracked(tuple(motions), done, turning, *came)


def _whole(values: Array, what: str) -> Array:
    """All joints of each motion as one number. Shape (motions,)."""
    if what == "energy":
        return values.sum(axis=1)
    if what in ("peak", "step"):
        return values.max(axis=1)
    return np.sqrt((values**2).sum(axis=1))


def _motions(
    store: Path,
    robot: Robot,
    manifests: Sequence[Mapping],
    runs: Sequence[str],
    seeds: int,
) -> tuple[Motion, ...]:
    out, families = [], {}
    for word, manifest in zip(runs, manifests, strict=True):
        id = find(store, word).id
        plant = hidden_plant(store, id, manifest)
        if plant is None:
            raise InputError(
                f"Run {id} has no sealed arm to drive: it was measured, or its sealed "
                "half was taken out. Give simulated runs."
            )
        spec = manifest["spec"]
        asked, rate = TrajectorySpec(**spec["trajectory"]), spec["rates"]["control"]
        out.append(Motion(make_reference(robot, asked, rate), plant, id))
        families.setdefault(asked.kind, (asked, rate, plant))
    for (kind, (asked, rate, plant)), i in product(families.items(), range(seeds)):
        seed = derived_seed(asked.seed, f"track/{kind}/{i}")
        motion = make_reference(robot, replace(asked, seed=seed), rate)
        out.append(Motion(motion, plant, None))
    return tuple(out)


def _put(store: Path, robot: Robot, asked: Mapping, made: Tracked) -> str:
    rows = [
        {
            "run_id": motion.run_id,
            "trajectory": motion.reference.kind,
            "joint": joint,
            "stage": cell,
            "metric": metric,
            "value": float(value),
        }
        for cell, drives in made.cells.items()
        for motion, one in zip(made.motions, drives, strict=True)
        for what, metric in METRICS.items()
        for joint, value in enumerate(getattr(one, what), 1)
    ]
    record = {
        "robot": robot.name,
        "kind": KIND,
        "model_id": asked["model"] or asked["calibration"],
        "request": asked,
        "gains": plain([asdict(gain) for gain in made.gains]),
        "turning": plain({"width": made.width, "torque_rate": made.torque_rate}),
    }
    table = pa.Table.from_pylist(rows, schema=arrow_schema(VIEWS["errors"][1:]))
    of_models = [asked[k] for k in ("model", "calibration") if asked[k] is not None]
    parents = {"run": list(asked["runs"]), "model": of_models}
    return commit_record(store, "validations", record, {"errors": table}, parents)
