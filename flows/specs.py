"""Experiment files (SPEC.toml), and campaign files with [grid] or [random]."""

import hashlib
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from copy import deepcopy
from itertools import product
from math import exp, log, prod
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from flows.requests import check_tags
from residual.drive import Drive
from residual.errors import InputError, check_keys, quote_value, shorten_value
from residual.model.dynamics import AS_MEASURED
from residual.robot.files import SERIAL
from sim.engine.plant_records import (
    CLEAN,
    BackgroundWord,
    PlantEffect,
    PlantSpec,
    SampleRates,
    SensorNoise,
    ServoDrive,
    TrajectorySpec,
)
from warehouse.toml_records import build_toml_record, read_toml

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


class DriveTable(SpecTable):
    """[drive]: the drives of an arm that is sent goals, as its log describes them.

    One value per joint; an empty table only marks such an arm.
    """

    gain: _Row = ()
    limit: _Row = ()
    delay: _Row = ()
    goal_speed: _Row = ()

    @model_validator(mode="after")
    def _check_drive(self) -> "DriveTable":
        Drive(self.gain, self.limit, self.delay, self.goal_speed)
        return self


class ServoTable(DriveTable):
    """[plant.drive]: differences of the drives from [drive]."""

    damping: _Row = ()


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
    drive: ServoTable | None = None


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

    `start` is the time of the session at which the motion begins [s]. `serial` and
    `tags` go into the record of the run and are in neither half of its spec.
    """

    schema_: Literal[1] = Field(1, alias="schema")
    robot: str = "irb140"
    seed: Seed = 0
    start: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    trajectory: TrajectoryTable = TrajectoryTable()
    plant: PlantTable = PlantTable()
    rates: RatesTable = RatesTable()
    controller: ControllerTable = ControllerTable()
    drive: DriveTable | None = None
    serial: Annotated[str, Field(pattern=f"^({SERIAL.pattern})$")] | None = None
    tags: Annotated[tuple[str, ...], _List] = ()

    @field_validator("tags")
    @classmethod
    def _check_tags(cls, tags: tuple[str, ...]) -> tuple[str, ...]:
        try:
            return tuple(check_tags(tags))
        except InputError as error:
            raise ValueError(str(error).removesuffix(".")) from error

    @model_validator(mode="after")
    def _check_drives(self) -> "ExperimentSpec":
        if self.plant.drive is not None and self.drive is None:
            raise ValueError(
                "[plant.drive] needs [drive]; add [drive] with the values that the log "
                "has of the drives, or empty"
            )
        if self.drive is not None and self.controller.model != NOMINAL:
            raise ValueError(
                "an arm with [drive] is sent goals, so no model can drive it; remove "
                "[controller] or [drive]"
            )
        return self

    def reference(self) -> TrajectorySpec:
        """The reference motion."""
        table = self.trajectory
        seed = table.seed
        if seed is None:
            seed = derive_seed(self.seed, "reference")
        return TrajectorySpec(table.kind, table.duration, table.periods, seed, table.coefficients)

    def log_rates(self) -> SampleRates:
        """Rates of controller and log."""
        return SampleRates(self.rates.control, self.rates.log)

    def plant_spec(self) -> PlantSpec:
        """The sealed half for the plant."""
        table = self.plant
        seed = derive_seed(self.seed, "plant") if table.seed is None else table.seed
        servo = None
        if self.drive is not None:
            true = (table.drive or ServoTable()).model_dump(exclude_unset=True)
            servo = ServoDrive(**{**self.drive.model_dump(), **true})
        return PlantSpec(
            effects=tuple(effect.record() for effect in table.effect),
            scatter=table.scatter,
            noise=SensorNoise(table.noise.torque, table.noise.encoder),
            seed=seed,
            salt=table.salt,
            background=table.background,
            worked_before=table.worked_before,
            drive=servo,
        )


def derive_seed(seed: int, name: str) -> int:
    """Return the independent seed of a purpose, such as "reference"."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return int.from_bytes(digest[:4], "little")


def load_spec(path: str | Path) -> ExperimentSpec:
    """Read and check a SPEC.toml."""
    return parse_spec(read_toml(path), path)


def parse_spec(content: dict, path: str | Path) -> ExperimentSpec:
    """Check the content of a SPEC.toml; robot files are relative to its folder."""
    for table in _CHANGES:
        if table in content:
            raise InputError(
                f"{Path(path).name} has [{table}], so it is a campaign. "
                f"Run modelgap campaign {path}."
            )
    spec = build_toml_record(ExperimentSpec, content, Path(path).name, _CHANGES)
    beside = Path(path).parent / spec.robot
    with suppress(OSError):  # a name that no file can have, such as a very long one
        if not Path(spec.robot).is_absolute() and beside.exists():
            return spec.model_copy(update={"robot": str(beside)})
    return spec


MOST = 10_000  # runs
_CHANGES = ("grid", "random")  # tables of a campaign
# Keys that `[campaign] sealed = false` opens: not those that reveal the draws.
_OPENABLE = ("plant.effect.", "plant.background", "plant.worked_before")
_RANGE = ("low", "high", "log")
_LARGEST = 2**62  # of a bound; NaN is none


class CampaignTable(SpecTable):
    """[campaign]: whether varied keys of [plant] are sealed from queries."""

    sealed: bool = True


class _CampaignFile(SpecTable):
    campaign: CampaignTable = CampaignTable()


class CampaignEntry(NamedTuple):
    """One experiment of a campaign."""

    label: str  # its changes, for people
    spec: ExperimentSpec
    points: Mapping[str, Any]  # those of its changes that the store may show, by axis
    sealed: tuple[str, ...]  # the other axes


def load_campaign(path: str | Path, seed: int | None = None) -> tuple[CampaignEntry, ...]:
    """Read a campaign and return its experiments.

    [grid] combines every list with every other. [random] draws `count` experiments:
    from a list, or from {low, high}, uniformly or in `log`. Each draw has its own seed;
    a seed under [trajectory] or [plant] keeps motion or arm the same.
    """
    content = read_toml(path) | ({} if seed is None else {"seed": seed})
    table = {"campaign": content.pop("campaign", {})}
    sealed = build_toml_record(_CampaignFile, table, Path(path).name).campaign.sealed
    grid, draws = content.pop("grid", None), content.pop("random", None)
    if (grid is None) == (draws is None):
        raise InputError(
            f"{Path(path).name} has {'neither' if grid is None else 'both'} of [grid] "
            "and [random], expected one of them. modelgap experiment runs a single one."
        )
    changes = _grid_changes(grid) if draws is None else _random_changes(draws, content)
    return tuple(_entry(content, change, path, sealed) for change in changes)


Change = list[tuple[tuple[str, ...], Any]]


def _grid_changes(grid: Any) -> list[Change]:
    axes = list(_leaves(grid, "grid"))
    for keys, values in axes:
        if not isinstance(values, list) or not values:
            raise InputError(
                f"{_where('grid', keys)} is {quote_value(values)}, expected a list of values."
            )
    count = prod(len(values) for _, values in axes)
    if not axes or count > MOST:
        number = count if axes else 0
        raise InputError(f"[grid] asks for {number} runs, expected 1 to {MOST}.")
    names = [keys for keys, _ in axes]
    return [
        list(zip(names, values, strict=True)) for values in product(*(values for _, values in axes))
    ]


def _random_changes(draws: Any, content: dict) -> list[Change]:
    count = draws.pop("count", None) if isinstance(draws, dict) else None
    if type(count) is not int or not 1 <= count <= MOST:
        raise InputError(f"[random] count is {quote_value(count)}, expected 1 to {MOST}.")
    axes = list(_leaves(draws, "random"))
    seed = content.get("seed", 0)
    if type(seed) is not int or seed < 0:
        raise InputError(f"seed is {quote_value(seed)}, expected a whole number, 0 or more.")
    changes = []
    for i in range(count):
        change: Change = [(("seed",), derive_seed(seed, f"random/{i}"))]
        for keys, values in axes:
            # A stream per key and draw: another key does not change these draws.
            name = f"random/{i}/{'.'.join(keys)}"
            rng = np.random.default_rng(derive_seed(seed, name))
            change.append((keys, _draw(values, keys, rng)))
        changes.append(change)
    return changes


def _draw(values: Any, keys: tuple[str, ...], rng: np.random.Generator) -> Any:
    if isinstance(values, list) and values:
        return values[int(rng.integers(len(values)))]
    where = _where("random", keys)
    if not isinstance(values, dict):
        raise InputError(f"{where} is {quote_value(values)}, expected a list or {{low, high}}.")
    check_keys(values, _RANGE, where)
    low, high = values.get("low"), values.get("high")
    numbers = all(type(v) in (int, float) and abs(v) < _LARGEST for v in (low, high))
    if not numbers or not low < high or (values.get("log") and low <= 0):
        raise InputError(
            f"{where} is low {quote_value(low)} to high {quote_value(high)}, expected low < high"
            f"{' and low > 0 for log' if values.get('log') else ''}."
        )
    if values.get("log"):
        return float(exp(rng.uniform(log(low), log(high))))
    if type(low) is int and type(high) is int:
        return int(rng.integers(low, high + 1))
    return float(rng.uniform(low, high))


def _where(table: str, keys: tuple[str, ...]) -> str:
    return f"[{table}] {shorten_value('.'.join(keys))}"


def _leaves(table: Any, where: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    if not isinstance(table, dict):
        raise InputError(f"{where} is {quote_value(table)}, expected a table.")
    for key, value in table.items():
        if isinstance(value, dict) and not {"low", "high"} & set(value):
            yield from (((key, *inner), v) for inner, v in _leaves(value, where))
        else:
            yield (key,), value


def _entry(content: dict, change: Change, path: str | Path, sealed: bool) -> CampaignEntry:
    changed, axes = deepcopy(content), {}
    for keys, value in change:
        axis = ".".join(keys)
        if keys[0] in ("serial", "tags"):
            raise InputError(f"{axis} changes no id, so a campaign cannot vary it.")
        _put(changed, keys, value, axis)
        axes[axis] = value
    points = {axis: value for axis, value in axes.items() if _is_open(axis, sealed)}
    spec, hidden = parse_spec(changed, path), tuple(a for a in axes if a not in points)
    return CampaignEntry(format_point(axes), spec, points, hidden)


def _is_open(axis: str, sealed: bool) -> bool:
    """Whether the store may show an axis; never the draws of the plant."""
    if axis.startswith(_OPENABLE):
        return not sealed
    return axis != "seed" and not axis.startswith("plant.")


def format_point(axes: Mapping[str, Any]) -> str:
    """Return the changes of an experiment in one line."""
    words = (f"{v:.4g}" if isinstance(v, float) else str(v) for v in axes.values())
    return " ".join(f"{axis}={word}" for axis, word in zip(axes, words, strict=True))


def _put(place: Any, keys: tuple[str, ...], value: Any, name: str) -> None:
    """Set a value by its keys; of several effects `plant.effect.2.level`."""
    key, *inner = keys
    if isinstance(place, list):
        number = int(key) if re.fullmatch("[0-9]{1,9}", key) else 0
        if not number and len(place) == 1:
            _put(place[0], keys, value, name)
        elif inner and 1 <= number <= len(place):
            _put(place[number - 1], tuple(inner), value, name)
        else:
            raise InputError(
                f"{name}: there are {len(place)} of these tables; select one by "
                "its number from 1, as in plant.effect.2.level."
            )
    elif not isinstance(place, dict):
        raise InputError(f"{name} does not name a key of a table.")
    elif inner:
        _put(place.setdefault(key, {}), tuple(inner), value, name)
    else:
        place[key] = value
