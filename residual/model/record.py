"""A model as plain values that JSON can hold, and back, with tables or without."""

import json
from collections.abc import Mapping
from pathlib import Path

from residual.errors import InputError
from residual.model.corrected import Corrected
from residual.model.model import Model
from residual.model.whole import check_whole
from residual.names import check_nesting

# What lists and tables of other sizes and kinds make Python say.
_DAMAGED = (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError)


def to_record(model: Model | Corrected) -> dict:
    """Return a model whole: robot, inertial parameters, effects, signal path, tables.

    Returns:
        Plain values; `from_record` makes a model of the same bits of them.
    """
    return model.to_record()


def from_record(record: Mapping) -> Model | Corrected:
    """Return the model of a record.

    Raises:
        InputError: If it is of another form, or damaged.
    """
    try:
        made = (Corrected if "tables" in record else Model).from_record(record)
        check_whole(getattr(made, "model", made))
    except _DAMAGED as error:
        raise InputError(f"The record of a model is damaged: {error}.") from error
    return made


def load_model(path: str | Path) -> Model | Corrected:
    """Return the model that was saved into a file.

    Raises:
        InputError: If the file cannot be read or holds no model.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except RecursionError as error:
        raise InputError(f"{path} is no model: it is nested too deep.") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not the file of a model: {error}.") from error
    if not isinstance(content, dict):
        raise InputError(
            f"{path} is not the file of a model. Expected what Model.save wrote."
        )
    check_nesting(content, str(path))
    return from_record(content)
