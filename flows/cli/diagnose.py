"""modelgap diagnose."""

from dataclasses import replace

from flows.cli.app import Outputs
from flows.outputs import progress_bar, read_files
from flows.requests import Diagnose, File, HeldOutWhere, Log, Where


def diagnose(
    *logs: Log,
    request: Diagnose,
    where: Where = None,
    held_out_where: HeldOutWhere = None,
    report: File = None,
    json: File = None,
    save_model: File = None,
) -> None:
    """Find and name the effects missing from a robot model.

    Fits the model to the logs, adds the effects that the logs show and the model
    lacks, and compares the errors on the held-out logs of --holdout.

    ```
    modelgap diagnose A.csv B.csv --robot arm.urdf --holdout C.csv --report out.html
    ```

    With one log only, fit its first part and hold out the rest:

    ```
    modelgap diagnose run.csv@:60% --robot arm.urdf --holdout run.csv@60%:
    ```

    With logs of the healthy robot, only changes are named:

    ```
    modelgap diagnose today.csv --robot arm.urdf --baseline healthy.csv
    ```

    Columns t (s), q1... (rad) and tau1... (N m) need no --map; no unit is guessed. The
    diagnosis of stored runs is stored too, and its model can be adopted (modelgap
    adopt).

    Args:
        logs: Logs to fit: CSV, Parquet, ROS bag or MCAP file, or id of a stored run.
            FILE@0:16.5 is a window in seconds from the first sample, FILE@60%: the last
            40 percent.
        report: HTML file for the report.
        json: File for the verdict as JSON; "-" prints it alone.
        save_model: File for the augmented model, for predict and export.
    """
    from flows.inputs.read import chosen, load_for
    from flows.report.diagnosis import print_diagnosis, render
    from flows.report.page import origin_of_request
    from flows.steps import diagnose as steps
    from flows.steps.models import choose_for
    from residual.model.record import to_text
    from residual.verdict.document import to_json

    request = chosen(request, logs, where, held_out_where)
    robot = load_for(request)
    choice = choose_for(request, robot)
    request = replace(request, model=choice.diagnosis)
    words = (*request.logs, *request.baseline, *request.held_out, request.robot)
    inputs = read_files(words, request.columns)
    files = {"--report": report, "--json": json, "--save-model": save_model}
    out = Outputs(files, inputs)
    read = steps.read_logs(request, robot)
    out.say(*read.lines[:1], *choice.lines, *read.lines[1:])
    stored = steps.as_stored(read)
    with progress_bar() as progress:
        result = steps.diagnose(request, stored or read, progress)
    # Those of the logs were printed before the work.
    out.say(*result.notes[len(read.lines) :])

    def page() -> str:
        origin = origin_of_request(request, str(report))
        return render(result, result.verdict.robot, origin=origin)

    out.write(
        {"--report": page, "--save-model": lambda: to_text(result.models["augmented"])},
        lambda: to_json(result.verdict),
    )
    print_diagnosis(result, out.console)
    kept = steps.keep(request, stored, result)[0] if stored else None
    out.finish(*([f"stored as a diagnosis: modelgap show {kept}"] if kept else []))
