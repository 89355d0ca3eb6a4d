"""A campaign file: SPEC.toml with [grid] (every combination) or [random] (draws)."""

import re
from collections.abc import Iterator
from copy import deepcopy
from itertools import product
from math import exp, log, prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flows.specs.experiment import ExperimentSpec, derived_seed, experiment_of
from residual.errors import InputError, check_keys, shortened, shown
from warehouse.toml import read_toml

MOST = 10_000  # runs
_RANGE = ("low", "high", "log")
_LARGEST = 2**62  # of a bound; NaN is none


class Entry(NamedTuple):
    """One experiment of a campaign."""

    label: str  # its changes, for people
    spec: ExperimentSpec


def load_campaign(path: str | Path, seed: int | None = None) -> tuple[Entry, ...]:
    """Read a campaign and return its experiments.

    [grid] combines every list with every other. [random] draws `count` experiments:
    from a list, or from {low, high}, uniformly or in `log`. Each draw has its own seed;
    a seed under [trajectory] or [plant] keeps motion or arm the same.
    """
    content = read_toml(path) | ({} if seed is None else {"seed": seed})
    grid, draws = content.pop("grid", None), content.pop("random", None)
    if (grid is None) == (draws is None):
        raise InputError(
            f"{Path(path).name} has {'neither' if grid is None else 'both'} of [grid] "
            "and [random], expected one of them. modelgap experiment runs a single one."
        )
    changes = _grid_changes(grid) if draws is None else _random_changes(draws, content)
    return tuple(_entry(content, change, path) for change in changes)


Change = list[tuple[tuple[str, ...], Any]]


def _grid_changes(grid: Any) -> list[Change]:
    """Return every combination; the last key runs fastest."""
    axes = list(_leaves(grid, "grid"))
    for keys, values in axes:
        if not isinstance(values, list) or not values:
            raise InputError(
                f"{_where('grid', keys)} is {shown(values)}, expected a list of values."
            )
    count = prod(len(values) for _, values in axes)
    if not axes or count > MOST:
        number = count if axes else 0
        raise InputError(f"[grid] asks for {number} runs, expected 1 to {MOST}.")
    names = [keys for keys, _ in axes]
    return [
        list(zip(names, values, strict=True))
        for values in product(*(values for _, values in axes))
    ]


def _random_changes(draws: Any, content: dict) -> list[Change]:
    count = draws.pop("count", None) if isinstance(draws, dict) else None
    if type(count) is not int or not 1 <= count <= MOST:
        raise InputError(f"[random] count is {shown(count)}, expected 1 to {MOST}.")
    axes = list(_leaves(draws, "random"))
    seed = content.get("seed", 0)
    if type(seed) is not int or seed < 0:
        raise InputError(f"seed is {shown(seed)}, expected a whole number, 0 or more.")
    changes = []
    for i in range(count):
        change: Change = [(("seed",), derived_seed(seed, f"random/{i}"))]
        for keys, values in axes:
            # A stream per key and draw: another key does not change these draws.
            name = f"random/{i}/{'.'.join(keys)}"
            rng = np.random.default_rng(derived_seed(seed, name))
            change.append((keys, _draw(values, keys, rng)))
        changes.append(change)
    return changes


def _draw(values: Any, keys: tuple[str, ...], rng: np.random.Generator) -> Any:
    if isinstance(values, list) and values:
        return values[int(rng.integers(len(values)))]
    where = _where("random", keys)
    if not isinstance(values, dict):
        raise InputError(
            f"{where} is {shown(values)}, expected a list or {{low, high}}."
        )
    check_keys(values, _RANGE, where)
    low, high = values.get("low"), values.get("high")
    numbers = all(type(v) in (int, float) and abs(v) < _LARGEST for v in (low, high))
    if not numbers or not low < high or (values.get("log") and low <= 0):
        raise InputError(
            f"{where} is low {shown(low)} to high {shown(high)}, expected low < high"
            f"{' and low > 0 for log' if values.get('log') else ''}."
        )
    if values.get("log"):
        return float(exp(rng.uniform(log(low), log(high))))
    if type(low) is int and type(high) is int:
        return int(rng.integers(low, high + 1))
    return float(rng.uniform(low, high))


def _where(table: str, keys: tuple[str, ...]) -> str:
    return f"[{table}] {shortened('.'.join(keys))}"


def _leaves(table: Any, where: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    if not isinstance(table, dict):
        raise InputError(f"{where} is {shown(table)}, expected a table.")
    for key, value in table.items():
        if isinstance(value, dict) and not {"low", "high"} & set(value):
            yield from (((key, *inner), v) for inner, v in _leaves(value, where))
        else:
            yield (key,), value


def _entry(content: dict, change: Change, path: str | Path) -> Entry:
    changed = deepcopy(content)
    for keys, value in change:
        _put(changed, keys, value, ".".join(keys))
    words = (
        f"{'.'.join(keys)}={value:.4g}"
        if isinstance(value, float)
        else f"{'.'.join(keys)}={value}"
        for keys, value in change
    )
    return Entry(" ".join(words), experiment_of(changed, path))


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
                f"{name}: there are {len(place)} of these tables; say which one by "
                "its number from 1, as in plant.effect.2.level."
            )
    elif not isinstance(place, dict):
        raise InputError(f"{name} does not name a key of a table.")
    elif inner:
        _put(place.setdefault(key, {}), tuple(inner), value, name)
    else:
        place[key] = value
