"""modelgap predict: the torque of a model on logs, whole or edited."""

from pathlib import Path

from flows.cli.options import STDOUT, Log, Words, console_beside, named_files
from flows.model_requests import Predict
from flows.outputs import (
    check_outside,
    check_writable,
    json_text,
    read_files,
    say,
    write_all,
)
from flows.report.console import show
from flows.report.models import prediction
from flows.settings import store_folder
from flows.steps import predict as steps
from residual.model.compare import WHOLE


def predict(
    *logs: Log,
    model: str,
    which: str | None = None,
    without: Words = (),
    out: str | None = None,
    map: str | None = None,
    json: str | None = None,
    store: str | None = None,
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
        model: Id of a diagnosis or model of the store, or a file that a model was
            saved into.
        which: Which model of a diagnosis: nominal, identified or augmented, which is
            the usual one.
        without: Effects to take out, as NAME or NAME@JOINT; without a joint all of
            that name.
        out: File for the samples, *.csv or *.parquet: log, t, tau1..., tau_model1...,
            and tau_edited1... with --without.
        map: TOML file that says which column is what, in which unit.
        json: File for the errors as JSON; "-" prints it and nothing else.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    check_outside("--out", out, store_folder(store))
    files = named_files({"--out": out, "--json": json})
    check_writable(files, read_files((*logs, model), map))
    if "--out" in files:
        steps.check_form(files["--out"])
    request = Predict(logs, model, which, without, map, store)
    console = console_beside(json)
    found, read = steps.read(request)
    say(console, f"model: {found!r}", *read.lines[1:])
    made = steps.predict(request, found, read)
    edited = [f"edited: {one!r}" for name, one in made.models.items() if name != WHOLE]
    say(console, *edited, *(f"warning: {w}" for w in read.warnings))
    show(console, prediction(steps.tables(made)))
    text = json_text(steps.document(made, request))
    contents: dict[Path, str | bytes] = {}
    if "--out" in files:
        contents[files["--out"]] = steps.written(made, files["--out"])
    if "--json" in files:
        contents[files["--json"]] = text
    write_all(contents)
    say(console, *(f"wrote {path}" for path in contents))
    if json == STDOUT:
        print(text, end="")
