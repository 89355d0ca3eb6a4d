"""The verdict as JSON and back (docs/verdict.md).

The keys are those of the records (`result`), except as in `to_json`. Every key is always
present; inapplicable ones are null, and nothing is NaN.
"""

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from functools import cache

from pydantic import TypeAdapter, ValidationError

from residual.check.result import read_log_check as read_check
from residual.errors import InputError, quote_value
from residual.quantity import convert_to_plain_values
from residual.verdict.result import Verdict

SCHEMA = 1
# Python errors from lists and tables of wrong sizes and kinds.
_DAMAGED = (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError)
LATER = frozenset({"suspected", "too_small"})  # older records lack them


def to_json(verdict: Verdict) -> dict:
    """Return a verdict as JSON values, in its documented form."""
    found = asdict(verdict)
    error = found["error"]
    cutoff = {"filter": {"cutoff_hz": error.pop("cutoff_hz")}}
    found["error"] = {"metric": error.pop("metric"), **cutoff, **error}
    found["log_check"] = verdict.log_check and verdict.log_check.to_json()
    for effect in (*found["effects"], *found["background"], *found["suspected"]):
        splits = effect["evidence"].pop("splits")
        effect["evidence"] |= {"p_value": None, "splits": splits}
        for combination in effect["combinations"].values():
            del combination["determined"]  # it is, and does not say so
    return convert_to_plain_values({"schema": SCHEMA, **found})


def from_json(document: Mapping) -> Verdict:
    """Return the verdict of a document.

    Raises:
        InputError: If it is of another schema, a key is missing, or a value is of
            another kind than the record has.
    """
    if document.get("schema") != SCHEMA:
        raise InputError(
            f"A verdict of schema {document.get('schema')!r}, expected {SCHEMA}: "
            "diagnose its logs again."
        )
    try:
        for key in {field.name for field in fields(Verdict)} - LATER:
            document[key]
        error, check = document["error"], document["log_check"]
        error = {**error, "cutoff_hz": error["filter"]["cutoff_hz"]}
        check = None if check is None else read_check(check)
        found = _form().validate_python({**document, "error": error, "log_check": check})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        words = f"{place}: {first['msg']}"
        raise InputError(f"The verdict is incomplete: {words}.") from error
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError(f"The verdict is incomplete: {quote_value(error)}.") from error
    in_order = sorted(found.effects, key=lambda effect: effect.order)
    return replace(found, effects=tuple(in_order))


def parse_verdict(document: object) -> Verdict:
    """Return the verdict of a document with checked types of values.

    Raises:
        InputError: If one is wrong; a record of the store may be foreign.
    """
    try:
        verdict = from_json(document)
        # A wrong type shows when the verdict is printed and written again.
        to_json(verdict), str(verdict), repr(verdict.effects)
    except _DAMAGED as error:
        raise InputError(f"This is no whole verdict: {error!r}.") from error
    return verdict


@cache
def _form() -> TypeAdapter[Verdict]:
    # Created on first use: it takes 25 ms.
    return TypeAdapter(Verdict)
