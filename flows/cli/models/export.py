"""modelgap export: a model in the form of another program."""

from pathlib import Path

from flows.cli.options import STDOUT, console_beside, named_files
from flows.outputs import (
    check_new_folder,
    check_outside,
    check_writable,
    json_text,
    read_files,
    say,
    write_all,
)
from flows.requests import Export
from flows.settings import store_folder
from flows.steps import export as steps


def export(
    model: str,
    /,
    *,
    to: str,
    out: str,
    which: str | None = None,
    log: str | None = None,
    map: str | None = None,
    json: str | None = None,
    store: str | None = None,
) -> None:
    """Write a model in the form of another program, and try it there.

    ```
    modelgap export 3f2a --to mjcf --out for_mujoco
    modelgap export model.json --to c99 --out for_the_controller
    modelgap export 3f2a --to urdf --out arm --which identified
    modelgap export model.json --to rrd --out seen --log monday.csv
    ```

    urdf: inertias, damping, dry friction. mjcf: for MuJoCo, with armature, springs and
    polynomial damping too. c99: one header with all named effects and tables. numpy:
    the same as a Python file that needs NumPy alone. table: friction over speed and
    torque over position, with few support points. fmu: FMI 2.0 for co-simulation.
    rrd: the moving arm with the torque of each effect, for the Rerun viewer. json: the
    whole model, for `mg.load_model`. What a target has no place for is listed, with the
    torque by which the export therefore differs; then the export is run in its target
    and compared with the model.

    Args:
        model: Id of a diagnosis or model of the store, or a file that a model was
            saved into.
        to: The target.
        out: New folder for the files.
        which: Which model of a diagnosis: nominal, identified or augmented, which is
            the usual one.
        log: With rrd: a log of the robot (FILE, FILE@0:16.5, or the id of a run), to
            see its torque and what the model leaves of it.
        map: TOML file that says which column of the log is what, in which unit.
        json: File for what is left out and for the proof; "-" prints it and nothing
            else.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    check_outside("--out", out, store_folder(store))
    check_new_folder("--out", Path(out))
    check_writable(named_files({"--json": json}), read_files((model, log or ""), map))
    console = console_beside(json)
    made = steps.export(Export(model, to, which, log, map, store))
    Path(out).mkdir(exist_ok=True)
    text = json_text(steps.document(made))
    contents = steps.in_place(made, out)
    write_all(contents | {p: text for p in named_files({"--json": json}).values()})
    say(console, *steps.words(made), *(f"wrote {path}" for path in contents))
    if json == STDOUT:
        print(text, end="")
