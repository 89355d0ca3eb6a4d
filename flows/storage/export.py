"""The model that a word stands for: a file, or a record of the store."""

from pathlib import Path

from flows.storage.calibration import CORRECTED
from flows.storage.diagnosis import read_models, read_models_record
from residual.errors import InputError
from residual.export.exported import Whole
from residual.model.record import from_record, load_model
from residual.names import check_name
from warehouse.layout import find, read_record

USUAL = "augmented"
# Keys of the record of a model, as identify and calibrate write them.
_ALONE = ("model", "nominal")


def read_model(store: Path, word: str, which: str | None = None) -> Whole:
    """Return a model of a file, of a diagnosis, or of a model of the store.

    Args:
        word: File of a model, or the id of a record; the beginning is enough.
        which: Which of the models of a diagnosis; None for the augmented one.

    Raises:
        InputError: If there is none, or it was kept without its numbers.
        UnknownNameError: If the diagnosis has no model of that name.
    """
    if Path(word).is_file():
        if which is not None:
            raise InputError(
                f"{word} holds one model; --which chooses among those of a diagnosis."
            )
        return load_model(word)
    if word.endswith(".json") or "/" in word:
        raise InputError(f"There is no file {word}. Name one that holds a model.")
    found = find(store, word)
    if found.kind == "diagnoses":
        kept = read_models(store, found.id)
        return kept[check_name(which or USUAL, kept, "model of the diagnosis")]
    if found.kind != "models":
        raise InputError(
            f"{word} is one of {found.kind}, which hold no model. Name a diagnosis or "
            "a model: modelgap sql 'SELECT model_id, robot, stage FROM models'."
        )
    if (found.folder / CORRECTED).is_file():
        return load_model(found.folder / CORRECTED)
    return _of_record(read_record(store, found.id), word, which)


def _of_record(record: dict, word: str, which: str | None) -> Whole:
    if record.get("models"):
        kept = read_models_record(record["models"])
        return kept[check_name(which or USUAL, kept, "model of the diagnosis")]
    for key in _ALONE:
        if record.get(key):
            return from_record(record[key])
    raise InputError(
        f"Model {word} was kept without its numbers. Make it again with this version."
    )
