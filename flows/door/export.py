"""Export from Python: a model in the form of another program, and its proof."""

from pathlib import Path

from flows.outputs import check_new_folder, write_all
from flows.steps.export import Made, export_model, in_place
from residual.export.exported import Whole
from residual.recording import Recording


def export(
    model: Whole, to: str, folder: str | Path, log: Recording | None = None
) -> Made:
    """Write a model in the form of another program, and try it there.

    Args:
        model: The model, with tables on it or without.
        to: urdf, mjcf, c99, numpy, table, fmu, rrd or json.
        folder: A new folder for the files.
        log: With rrd: a log of the robot, to see its torque and its residual.

    Returns:
        `export.left` is what is not carried, `proof` what came back out of the target.

    Raises:
        InputError: If there is no such target, it cannot take the model, the folder is
            not empty, or a package that the target needs is not installed.
    """
    check_new_folder("folder", Path(folder))
    made = export_model(model, to, log)
    Path(folder).mkdir(exist_ok=True)
    write_all(in_place(made, folder))
    return made
