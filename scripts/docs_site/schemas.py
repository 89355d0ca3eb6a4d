"""JSON schemas of what users write or read, made from the program's records."""

from functools import cache
from typing import Any

from pydantic import TypeAdapter

from flows.specs import ExperimentSpec
from residual.check.result import KINDS
from residual.effects import list_effect_parameters
from residual.robot import files as robot_files
from residual.verdict.document import SCHEMA
from residual.verdict.result import Verdict
from warehouse.logs.column_map import _File as ColumnsFile

Schema = dict[str, Any]
FOLDER = "schemas"
_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_NUMBER: Schema = {"type": "number"}
_ROW: Schema = {"type": "array", "items": _NUMBER}  # one entry per joint
_TEXT: Schema = {"type": "string"}


@cache
def schemas() -> dict[str, Schema]:
    """Return every schema by its place on the site."""
    parts = {
        "verdict": _verdict(),
        "columns": TypeAdapter(ColumnsFile).json_schema(),
        "robot": _robot(),
        "spec": _spec(),
    }
    return {f"{FOLDER}/{k}.json": {"$schema": _DIALECT, **v} for k, v in parts.items()}


def _verdict() -> Schema:
    """The records of a verdict, with the keys that its JSON has in another place."""
    schema = TypeAdapter(Verdict).json_schema(mode="serialization")
    parts = schema["$defs"]
    schema["properties"] = {"schema": {"const": SCHEMA}, **schema["properties"]}
    errors = parts["ErrorTables"]["properties"]
    errors["filter"] = _table({"cutoff_hz": errors.pop("cutoff_hz")}, every=True)
    parts["Evidence"]["properties"]["p_value"] = {"type": "null"}
    for name in {"Fault", "Repair"} & set(parts):
        del parts[name]
    fault = {
        "kind": {"enum": sorted(KINDS)},
        "joints": {"type": "array", "items": {"type": "integer", "minimum": 1}},
        "certain": {"type": "boolean"},
        "evidence": _TEXT,
        "repair": {"type": ["string", "null"]},
    }
    check = {
        "schema": {"const": SCHEMA},
        "verdict": {"enum": ["clean", "suspect", "unusable"]},
        "faults": {"type": "array", "items": _table(fault, every=True)},
    }
    parts["LogCheck"] = _table(check, every=True)
    for part in (schema, *parts.values()):
        part["additionalProperties"] = False
        # The deviations of `combinations` are determined, and do not repeat it.
        part["required"] = sorted(set(part["properties"]) - {"determined"})
    return schema


def _table(properties: Schema, every: bool = False) -> Schema:
    table = {"type": "object", "properties": properties, "additionalProperties": False}
    return table | ({"required": sorted(properties)} if every else {})


def _robot() -> Schema:
    """The keys of a robot.toml; the number of joints follows from the robot."""
    slug, serial = robot_files.SLUG.pattern, robot_files.SERIAL.pattern
    about = {
        "name": _TEXT | {"pattern": f"^{slug}$"},
        "serial": _TEXT | {"pattern": f"^{serial}$"},
        "gravity": _ROW | {"minItems": 3, "maxItems": 3},
        "gravcomp": {"type": "boolean"},
    }
    gear = ("gear_ratio", "torque_per_unit")
    limits = ("torque_limit", "velocity_limit", "acceleration_limit")
    positive = {"type": "array", "items": _NUMBER | {"exclusiveMinimum": 0}}
    scale = {"anyOf": [{"const": "estimate"}, _NUMBER | {"exclusiveMinimum": 0}]}
    origin = {"assumed": {"type": "boolean"}, "source": _TEXT}
    columns = TypeAdapter(ColumnsFile).json_schema()
    parts = columns.pop("$defs", {})
    return _table(
        {
            "robot": _table(about),
            "chain": _table({"joints": {"type": "array", "items": _TEXT}}),
            "locked": {"type": "object", "additionalProperties": _NUMBER},
            "joints": _table(dict.fromkeys(gear, _ROW) | dict.fromkeys(limits, positive)),
            "couplings": _table({"motor_from_joint": {"type": "array", "items": _ROW}}),
            "declared": _table(
                {
                    name: _table({**dict.fromkeys(parameters, _ROW), **origin})
                    for name, parameters in list_effect_parameters().items()
                }
            ),
            "prior": _table({"scale": scale}),
            "known": {"type": "object", "additionalProperties": _NUMBER},
            "columns": columns,
        }
    ) | {"$defs": parts}


def _spec() -> Schema:
    """An experiment; with [grid] or [random] a campaign."""
    schema = ExperimentSpec.model_json_schema()
    axes = {"type": "object"}
    schema["properties"] |= {"grid": axes, "random": axes}
    return schema
