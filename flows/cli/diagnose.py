"""modelgap diagnose."""

from dataclasses import replace
from time import perf_counter

from flows.cli.app import Outputs
from flows.outputs import list_input_files, show_progress_bar
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
    from flows.inputs.read import load_request_robot, select_request_runs
    from flows.report.diagnosis import print_diagnosis, render_diagnosis_page
    from flows.report.page import describe_request_origin
    from flows.steps import diagnose as steps
    from flows.steps.model_choice import choose_request_model
    from residual.model.model_files import format_model
    from residual.verdict.document import to_json

    request = select_request_runs(request, logs, where, held_out_where)
    robot = load_request_robot(request)
    choice = choose_request_model(request, robot)
    request = replace(request, model=choice.diagnosis)
    words = (*request.logs, *request.baseline, *request.held_out, request.robot)
    inputs = list_input_files(words, request.columns)
    files = {"--report": report, "--json": json, "--save-model": save_model}
    out = Outputs(files, inputs)
    read = steps.read_logs(request, robot)
    out.say(*read.lines[:1], *choice.lines, *read.lines[1:])
    stored = steps.resolve_whole_runs(read)
    begun = perf_counter()
    with show_progress_bar() as progress:
        result = steps.diagnose(request, stored or read, progress)
    took = perf_counter() - begun
    # Those of the logs were printed before the work.
    out.say(*result.notes[len(read.lines) :])

    def page() -> str:
        origin = describe_request_origin(request, str(report))
        return render_diagnosis_page(result, result.verdict.robot, origin=origin)

    out.write(
        {"--report": page, "--save-model": lambda: format_model(result.models["augmented"])},
        lambda: to_json(result.verdict),
    )
    print_diagnosis(result, out.console)
    kept = steps.store_diagnosis(request, stored, result, took)[0] if stored else None
    out.finish(*([f"stored as a diagnosis: modelgap show {kept}"] if kept else []))
