"""modelgap diagnose: what the model lacks, from measured logs."""

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
    """Name what the model of a robot lacks, from its logs.

    The logs to diagnose come first. The model is fitted to them, effects that they
    show and the model lacks are added, and the error before and after is taken on
    the logs of --holdout.

    ```
    modelgap diagnose A.csv B.csv --robot arm.urdf --holdout C.csv --report out.html
    ```

    One log only: fit its first part, prove on the rest.

    ```
    modelgap diagnose run.csv@:60% --robot arm.urdf --holdout run.csv@60%:
    ```

    A diagnosis of runs of the store is kept there, and its model may be adopted
    (modelgap adopt).

    What has changed since the robot was healthy?

    ```
    modelgap diagnose today.csv --robot arm.urdf --baseline healthy.csv
    ```

    Logs with columns t (s), q1... (rad), tau1... (N m) are read as they are; anything
    else needs a --map. Nothing is converted by guess.

    Args:
        logs: Logs to diagnose: CSV, Parquet, ROS bag or MCAP, or the id of a run of
            the store. FILE@0:16.5 takes a window in seconds from the first sample,
            FILE@60%: the last 40 percent.
        report: HTML page to write.
        json: File for the verdict as JSON; "-" prints it and nothing else.
        save_model: File for the model with what was found, which predict and
            export take.
    """
    from flows.inputs.read import chosen, load_for
    from flows.report.diagnosis import print_diagnosis, render
    from flows.report.page import of_request
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
        found = steps.diagnose(request, stored or read, progress)
    # Those of the logs were printed before the work.
    out.say(*found.notes[len(read.lines) :])

    def page() -> str:
        origin = of_request(request, str(report))
        return render(found, found.verdict.robot, origin=origin)

    out.write(
        {
            "--report": page,
            "--save-model": lambda: to_text(found.models["augmented"]),
        },
        lambda: to_json(found.verdict),
    )
    print_diagnosis(found, out.console)
    kept = steps.keep(request, stored, found)[0] if stored else None
    out.finish(*([f"stored as a diagnosis: modelgap show {kept}"] if kept else []))
