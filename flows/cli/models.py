"""modelgap models, adopt, rollback, export and predict: models and their use."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from flows.cli.app import Outputs
from flows.outputs import check_new_folder, check_outside, read_files, say
from flows.report.console import show, wide
from flows.report.models import (
    ADOPTED_KEY,
    adoption_lines,
    adoptions,
    prediction,
)
from flows.requests import Export, File, Log, Predict, RobotName, Store, Text
from flows.settings import store_folder
from flows.steps import adopt as steps
from flows.steps import export as exporting
from flows.steps import predict as predicting
from residual.model.compare import WHOLE
from warehouse.remote import store_name

_PLAIN = steps.Adopt()


def models(*, robot: RobotName = None, store: Store = None) -> None:
    """List which model each robot has, since when and why.

    ```
    modelgap models
    modelgap models --robot irb140
    ```

    The last line of a robot is the model that commands on this store go by; the lines
    above are what it had before. `modelgap sql 'SELECT * FROM adopted'` has it too.

    Args:
        robot: List one robot alone: its name, or what --robot takes elsewhere.
    """
    console, listed = wide(Console()), steps.list_adoptions(store, robot)
    if not listed:
        whose = f"{robot} has" if robot else "Every robot has"
        say(console, f"{whose} its nominal model in {store_name(store_folder(store))}.")
        return
    show(console, adoptions(listed), ADOPTED_KEY)


def adopt(id: str, /, *, request: steps.Adopt = _PLAIN) -> None:
    """Let the augmented model of a diagnosis be the model of its robot from now on.

    ```
    modelgap adopt 77e0 --note "gripper changed on Monday"
    ```

    The whole of it: inertias, friction, effects that were named, tables. Commands on
    this store then go by it and say so. Held-out motion must bear it out: a lower
    error, on no joint a higher one, and each new effect of the size that the model
    gives it. A refusal says what is missing.

    Args:
        id: Id of a diagnosis, or of the model that it ended with.
    """
    number, judged = steps.adopt(replace(request, model=id))
    say(Console(), *adoption_lines(number, judged))


def rollback(*, robot: RobotName = None, note: Text = "", store: Store = None) -> None:
    """Give a robot the model back that it had before; nothing is deleted.

    ```
    modelgap rollback --robot irb140 --note "alarm on joint 2 all night"
    ```

    Args:
        robot: The robot; not needed where only one has an adopted model.
        note: A word about it, which is kept.
    """
    number, made = steps.roll_back(robot, note, store)
    now = "its nominal model"
    if made.diagnosis_id is not None:
        now = f"the model of diagnosis {made.diagnosis_id[:8]}"
    say(Console(), f"adoption {int(number)}: {made.robot} has {now} again")


def export(
    model: str,
    /,
    *,
    request: Export,
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

    urdf: inertias, damping, dry friction. mjcf: for MuJoCo, with armature, springs and
    polynomial damping too. mujoco: that, and a Python module beside it that adds every
    other force that a motion feels, Stribeck's too, as passive force. c99: one header
    with all named effects and tables. table: friction over speed and torque over
    position, with few support points. fmu: FMI 2.0, for model exchange and
    co-simulation. rrd: the moving arm with the torque of each effect, for the Rerun
    viewer. json: the whole model, for `mg.load_model`. What a target has no place for
    is listed, with the torque by which the export therefore differs.

    Args:
        model: Id of a diagnosis or model of the store, or a file that a model was
            saved into.
        out: New folder for the files.
        json: File for what is left out; "-" prints it and nothing else.
    """
    check_outside("--out", out, store_folder(request.store))
    check_new_folder("--out", Path(out))
    inputs = read_files((model, request.log or ""), request.columns)
    outputs = Outputs({"--json": json}, inputs)
    made = exporting.export(replace(request, model=model))
    Path(out).mkdir(exist_ok=True)
    outputs.write(
        document=lambda: exporting.document(made), more=exporting.in_place(made, out)
    )
    outputs.say(*exporting.words(made))
    outputs.finish()


def predict(
    *logs: Log,
    request: Predict,
    out: File = None,
    json: File = None,
) -> None:
    """Predict the torque of logs with a model; take effects out of it.

    With --without nothing is refitted: what was found goes, what the nominal model has
    goes back to its value there. A right cause then predicts the arm that never had it.

    ```
    modelgap predict monday.csv --model 3f2a
    modelgap predict before.csv --model model.json --without payload coulomb@3
    ```

    Args:
        logs: Logs to predict: CSV or Parquet, a window as in FILE@0:16.5 or
            FILE@60%:, or the id of a run of the store.
        out: File for the samples, *.csv or *.parquet: log, t, tau1..., tau_model1...,
            and tau_edited1... with --without.
        json: File for the errors as JSON; "-" prints it and nothing else.
    """
    check_outside("--out", out, store_folder(request.store))
    request = replace(request, logs=logs)
    inputs = read_files((*logs, request.model), request.columns)
    outputs = Outputs({"--out": out, "--json": json}, inputs)
    if "--out" in outputs.files:
        predicting.check_form(outputs.files["--out"])
    found, read = predicting.read(request)
    outputs.say(f"model: {found!r}", *read.lines[1:])
    made = predicting.predict(request, found, read)
    edited = [f"edited: {one!r}" for name, one in made.models.items() if name != WHOLE]
    outputs.say(*edited, *(f"warning: {w}" for w in read.warnings))
    show(outputs.console, prediction(predicting.tables(made)))
    outputs.write(
        {"--out": lambda: predicting.written(made, outputs.files["--out"])},
        lambda: predicting.document(made, request),
    )
    outputs.finish()
