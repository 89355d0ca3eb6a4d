"""A model as JSON: all of it."""

import json

from residual.export.exported import Exported, Whole, file_stem, split
from residual.model.record import to_record


def to_json(whole: Whole) -> Exported:
    """Return a model as the file that ``load_model`` reads."""
    text = json.dumps(to_record(whole), allow_nan=False, indent=1) + "\n"
    name = f"{file_stem(whole)}.json"
    return split(whole, lambda term: "").exported({name: text.encode()})
