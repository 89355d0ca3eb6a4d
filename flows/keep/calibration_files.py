"""The files of a calibration: tables, the model that they correct, and both as one."""

from residual.calibration.calibrate import Calibration, corrected_model
from residual.export.c99 import to_c99
from residual.export.exported import to_json
from residual.export.numpy_file import to_numpy
from residual.tables.lookup import export_lookup

CORRECTED = "corrected.json"


def calibration_files(made: Calibration) -> dict[str, bytes]:
    """Return what a calibration is exported as, content by file name.

    Args:
        made: The calibration.

    Returns:
        The tables and their evaluator (`export_lookup`); where they correct a model,
        `corrected.json` with both, and both as a file for NumPy and as a C header.
    """
    files = export_lookup(made.lookup)
    whole = corrected_model(made)
    if whole is None:
        return files
    (record,) = to_json(whole).files.values()
    both = {**to_numpy(whole).files, **to_c99(whole).files}
    return {**files, CORRECTED: record, **both}
