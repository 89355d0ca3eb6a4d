"""modelgap models, adopt, rollback, export and predict."""

from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from flows.cli import Outputs
from flows.outputs import check_outside, list_input_files, print_plain
from flows.requests import Columns, File, Flag, Log, ModelWord, RobotName, Store, Text, Which, Words
from flows.settings import resolve_store_folder
from residual.errors import InputError


def models(*, robot: RobotName = None, store: Store = None) -> None:
    """List the adopted models of each robot.

    ```
    modelgap models
    modelgap models --robot irb140
    ```

    The last line of a robot is its current model, which commands on this store use.
    In SQL: `modelgap sql 'SELECT * FROM adopted'`.

    Args:
        robot: List one robot only: its name, file or folder.
    """
    from flows.report import print_parts, widen_piped_console
    from flows.report.models import ADOPTED_KEY, build_adoption_table
    from flows.steps import model_choice as steps
    from warehouse.remote_store import format_store_name

    console, listed = widen_piped_console(Console()), steps.list_adoptions(store, robot)
    if not listed:
        subject = f"{robot} uses" if robot else "Every robot uses"
        print_plain(
            console,
            f"{subject} its nominal model in {format_store_name(resolve_store_folder(store))}.",
        )
        return
    print_parts(console, build_adoption_table(listed), ADOPTED_KEY)


def adopt(id: str, /, *, note: Text = "", force: Flag = False, store: Store = None) -> None:
    """Make the augmented model of a diagnosis the current model of its robot.

    ```
    modelgap adopt 77e0 --note "gripper changed on Monday"
    ```

    Commands on this store then use the whole model: inertias, friction, named effects
    and tables. The held-out error must be lower, on no joint higher, and every new
    effect must be confirmed at its size; otherwise the command refuses and prints the
    reason.

    Args:
        id: Id of a diagnosis, or of its model.
        note: A note that is stored with the adoption.
        force: Adopt it although the gate fails; needs a --note.
    """
    from flows.cli.service import settle_proposals
    from flows.report.models import describe_adoption
    from flows.steps import model_choice as steps

    number, judgment = steps.adopt(id, note, force, store)
    print_plain(Console(), *describe_adoption(number, judgment))
    settle_proposals(resolve_store_folder(store))


def rollback(*, robot: RobotName = None, note: Text = "", store: Store = None) -> None:
    """Restore the previous model of a robot.

    ```
    modelgap rollback --robot irb140 --note "alarm on joint 2 all night"
    ```

    Args:
        robot: The robot, or "NAME SERIAL" of one of several; not needed if only one has
            an adopted model.
        note: Reason, stored with the rollback.
    """
    from flows.cli.service import settle_proposals
    from flows.steps import model_choice as steps

    number, restored = steps.roll_back(robot, note, store)
    now = "its nominal model"
    if restored.diagnosis_id is not None:
        now = f"the model of diagnosis {restored.diagnosis_id[:8]}"
    print_plain(Console(), f"adoption {int(number)}: {restored.robot} is back at {now}")
    settle_proposals(resolve_store_folder(store))


def export(
    model: str,
    /,
    *,
    to: Annotated[str, Parameter(metavar="NAME")],
    which: Which = None,
    log: Annotated[str | None, Parameter(metavar="LOG")] = None,
    columns: Annotated[File, Parameter(name="--map")] = None,
    store: Store = None,
    out: Annotated[str, Parameter(metavar="FOLDER")],
    json: File = None,
) -> None:
    """Write a model in the form of another program.

    ```
    modelgap export 3f2a --to mjcf --out for_mujoco
    modelgap export model.json --to c99 --out for_the_controller
    modelgap export 3f2a --to urdf --out arm --which identified
    modelgap export model.json --to rrd --out seen --log monday.csv
    ```

    urdf: inertias, damping, dry friction. mjcf: the same for MuJoCo, with armature,
    springs and polynomial damping. mujoco: mjcf with a Python module that adds all
    other effects as passive forces. c99: one header with all named effects and tables.
    table: friction over speed and torque over position, with few support points.
    rrd: the moving arm with the torque of each effect, for the Rerun viewer. json: the
    whole model, for `mg.load_model`. The effects that a target cannot represent are
    listed with their torque.

    Args:
        model: Id of a stored diagnosis or model, or a saved model file.
        to: The target: urdf, mjcf, mujoco, c99, table, rrd or json.
        log: With rrd: a log of the robot (FILE, FILE@0:16.5, or the id of a run), for
            its torque and its residual.
        columns: Column map of that log (COLUMNS.toml).
        out: New folder for the files.
        json: File for the list of what is not exported; "-" prints it alone.
    """
    from flows.steps import export as exporting

    check_outside(out, resolve_store_folder(store))
    outputs = Outputs({"--json": json}, list_input_files((model, log or ""), columns), out)
    exported = exporting.export(model, to, which, log, columns, store)
    outputs.write(
        document=lambda: exporting.build_omissions_document(exported), folder=lambda: exported.files
    )
    outputs.say(*exporting.describe_export(exported))
    outputs.finish()


def predict(
    *logs: Log,
    model: ModelWord,
    which: Which = None,
    without: Annotated[Words, Parameter(metavar="EFFECT...")] = (),
    columns: Columns = None,
    store: Store = None,
    out: File = None,
    json: File = None,
) -> None:
    """Predict the torque of logs with a model, with or without its effects.

    --without refits nothing: it removes added effects, and gives those of the nominal
    model their nominal values. If the named cause is right, the rest predicts the arm
    without it.

    ```
    modelgap predict monday.csv --model 3f2a
    modelgap predict before.csv --model model.json --without payload coulomb@3
    ```

    Args:
        logs: Logs: files, windows (FILE@0:16.5, FILE@60%:) or ids of stored runs.
        without: Effects to remove, as NAME or NAME@JOINT; without a joint all of that
            name.
        out: File for the samples, *.csv or *.parquet: log, t, tau1..., tau_model1...,
            and tau_edited1... with --without.
        json: File for the errors as JSON; "-" prints it alone.
    """
    from flows.report import print_parts
    from flows.report.models import build_prediction_table
    from flows.steps import export as predicting

    check_outside(out, resolve_store_folder(store))
    inputs = list_input_files((*logs, model), columns)
    outputs = Outputs({"--out": out, "--json": json}, inputs)
    if out is not None and not out.endswith((".csv", ".parquet")):
        raise InputError(f"--out {out}: expected a file *.csv or *.parquet.")
    read, made = predicting.predict(logs, model, which, without, columns, store)
    outputs.say(*predicting.describe_models(made, without), *read.lines[1:])
    outputs.say(*(f"warning: {w}" for w in read.warnings))
    errors = predicting.build_error_tables(made)
    print_parts(outputs.console, build_prediction_table(errors, without))
    outputs.write(
        {"--out": lambda: predicting.encode_samples(made, outputs.files["--out"])},
        lambda: predicting.build_prediction_document(made, without),
    )
    outputs.finish()
