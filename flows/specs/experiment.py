"""SPEC.toml: one experiment, with an open and a sealed half.

The open half (robot, trajectory, rates, seed of the reference) is known to a diagnosis.
The sealed half (effects, scatter, noise, seeds of the plant) is not in the record of a
run.
"""

import hashlib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from residual.errors import InputError
from residual.model.dynamics import AS_MEASURED
from sim.engine.records import (
    CLEAN,
    BackgroundWord,
    Noise,
    PlantEffect,
    PlantSpec,
    Rates,
    TrajectorySpec,
)
from warehouse.toml import checked, read_toml

# Strict: TOML has types, so "7" for 7 or true for 1 is an error. Arrays are lists.
_List = BeforeValidator(lambda v: tuple(v) if isinstance(v, list) else v)
_Row = Annotated[tuple[Annotated[float, Field(allow_inf_nan=False)], ...], _List]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]


class SpecTable(BaseModel):
    """One table of a TOML file; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class TrajectoryTable(SpecTable):
    """[trajectory]: the reference motion; without a seed one is derived.

    `coefficients` are those of a given Fourier motion, or the places of a
    move-stop-move.
    """

    kind: Literal["fourier", "cyclic", "move_stop_move", "welding"] = "fourier"
    duration: Annotated[Positive, Field(le=600)] = 20.0
    periods: Annotated[int, Field(ge=1, le=100)] = 2
    seed: Seed | None = None
    coefficients: Annotated[tuple[_Row, ...], _List] = ()


class NoiseTable(SpecTable):
    """Sensor noise: share of the joint's torque range, and encoder step [rad]."""

    torque: Share = 0.015
    encoder: Annotated[float, Field(ge=0, le=0.1)] = 1e-4


class EffectTable(SpecTable):
    """[[plant.effect]]: every further key is a parameter of the effect, SI."""

    model_config = ConfigDict(frozen=True, extra="allow", strict=True)
    __pydantic_extra__: dict[str, Annotated[float, Field(allow_inf_nan=False)]]

    name: str
    joints: Annotated[tuple[Annotated[int, Field(ge=1)], ...], _List] = ()
    onset: Annotated[float, Field(ge=0, le=1e6)] = 0.0

    def record(self) -> PlantEffect:
        """The effect for the plant, its parameters in alphabetical order."""
        parameters = tuple(sorted(self.__pydantic_extra__.items()))
        return PlantEffect(self.name, self.joints, parameters, self.onset)


class PlantTable(SpecTable):
    """[plant]: the sealed half; without a seed one is derived.

    `background` is the background of all joints, `worked_before` the working time of
    the arm before its session [s], which warms it.
    """

    effect: Annotated[tuple[EffectTable, ...], _List] = ()
    scatter: Annotated[float, Field(ge=0, le=0.5)] = 0.02
    noise: NoiseTable = NoiseTable()
    seed: Seed | None = None
    salt: str = ""
    background: BackgroundWord = CLEAN
    worked_before: Annotated[float, Field(ge=0, le=1e6)] = 0.0


class RatesTable(SpecTable):
    """[rates]: of the controller and of the log [Hz]."""

    control: Annotated[Positive, Field(ge=50, le=20000)] = 1000.0
    log: Annotated[Positive, Field(le=20000)] = 250.0

    @model_validator(mode="after")
    def _check_ratio(self) -> "RatesTable":
        ratio = self.control / self.log
        if ratio < 1 or abs(ratio - round(ratio)) > 1e-9:
            raise ValueError(
                f"control is {self.control:g} Hz and log {self.log:g} Hz; control "
                "must be a whole multiple of log"
            )
        return self


NOMINAL = "nominal"


class ControllerTable(SpecTable):
    """[controller]: the model that drives the arm, and how.

    `model` is nominal, adopted, or the id of a stored diagnosis, model or calibration;
    `kind` is computed torque, or feed-forward added to plain feedback. `encoder_step`
    [rad] and `rise` [s] smooth its dry friction at reversals.
    """

    kind: Literal["computed_torque", "feed_forward"] = "computed_torque"
    model: Annotated[str, Field(pattern="^(nominal|adopted|[0-9a-f]{1,20})$")] = NOMINAL
    encoder_step: Annotated[float, Field(gt=0, le=0.1)] = AS_MEASURED.encoder_step
    rise: Annotated[float, Field(ge=0, le=10)] = AS_MEASURED.rise

    @model_validator(mode="after")
    def _check_model(self) -> "ControllerTable":
        if self.model == NOMINAL and self.kind != "computed_torque":
            raise ValueError(
                "the nominal model closes the loop (computed_torque); name another "
                "model for feed_forward"
            )
        return self


class ExperimentSpec(SpecTable):
    """One experiment: SPEC.toml with its defaults.

    `start` is the time of the session at which the motion begins [s].
    """

    schema_: Literal[1] = Field(1, alias="schema")
    robot: str = "irb140"
    seed: Seed = 0
    start: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    trajectory: TrajectoryTable = TrajectoryTable()
    plant: PlantTable = PlantTable()
    rates: RatesTable = RatesTable()
    controller: ControllerTable = ControllerTable()

    def reference(self) -> TrajectorySpec:
        """The reference motion."""
        table = self.trajectory
        seed = table.seed
        if seed is None:
            seed = derived_seed(self.seed, "reference")
        return TrajectorySpec(
            table.kind, table.duration, table.periods, seed, table.coefficients
        )

    def log_rates(self) -> Rates:
        """Rates of controller and log."""
        return Rates(self.rates.control, self.rates.log)

    def plant_spec(self) -> PlantSpec:
        """The sealed half for the plant."""
        table = self.plant
        seed = derived_seed(self.seed, "plant") if table.seed is None else table.seed
        return PlantSpec(
            effects=tuple(effect.record() for effect in table.effect),
            scatter=table.scatter,
            noise=Noise(table.noise.torque, table.noise.encoder),
            seed=seed,
            salt=table.salt,
            background=table.background,
            worked_before=table.worked_before,
        )


def derived_seed(seed: int, name: str) -> int:
    """Return the independent seed of a purpose, such as "reference"."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return int.from_bytes(digest[:4], "little")


def load_spec(path: str | Path) -> ExperimentSpec:
    """Read and check a SPEC.toml."""
    return experiment_of(read_toml(path), path)


def experiment_of(content: dict, path: str | Path) -> ExperimentSpec:
    """Check the content of a SPEC.toml; robot files are relative to its folder."""
    for table in ("grid", "random"):
        if table in content:
            raise InputError(
                f"{Path(path).name} has [{table}], so it is a campaign. "
                f"Run modelgap campaign {path}."
            )
    spec = checked(ExperimentSpec, content, Path(path).name)
    beside = Path(path).parent / spec.robot
    if not Path(spec.robot).is_absolute() and _exists(beside):
        return spec.model_copy(update={"robot": str(beside)})
    return spec


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that no file can have, such as a very long one
        return False
