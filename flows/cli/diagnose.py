"""modelgap diagnose: what the model lacks, from measured logs."""

from dataclasses import replace

from flows.cli.options import (
    STDOUT,
    Flag,
    Log,
    Words,
    console_beside,
    named_files,
    parse_declared,
)
from flows.outputs import (
    check_writable,
    json_text,
    progress_bar,
    read_files,
    say,
    write_all,
)
from flows.requests import Diagnose
from flows.steps import diagnose as steps
from flows.steps.loop.choose import Wanted, choose_for
from residual.lazy import Lazy

page = Lazy("flows.report.next")
origin = Lazy("flows.report.made")
terminal = Lazy("flows.report.diagnosis")
result = Lazy("residual.diagnosis.result")
verdict = Lazy("residual.diagnosis.verdict")


def diagnose(
    *logs: Log,
    robot: str,
    baseline: Words = (),
    holdout: Words = (),
    declared: str | None = None,
    map: str | None = None,
    report: str | None = None,
    json: str | None = None,
    null: str | None = None,
    store: str | None = None,
    trust_log: Flag = False,
    model: str | None = None,
    verbose: Flag = False,
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
        robot: Built-in name (irb140), URDF file, or folder with one *.urdf and an
            optional robot.toml.
        baseline: Logs of healthy runs of the robot; then what has changed is named.
        holdout: Logs for the proof. Without them the last quarter of the longest log.
        declared: Effects that the model has, as a,b; "none" for a bare rigid body.
            Without it the robot's own list, or viscous,coulomb,rotor_inertia.
        map: TOML file that says which column is what, in which unit.
        report: HTML page to write.
        json: File for the verdict as JSON; "-" prints it and nothing else.
        null: What modelgap calibrate-null wrote with --out; without it, one that fits
            is looked for in the store.
        store: Folder of the store with runs and nulls; else $MODELGAP_STORE, else
            ./store.
        trust_log: Go on although a fault of the logs is certain (modelgap check); the
            answer is then "unknown", and names nothing.
        model: "nominal", or the id of a diagnosis whose model is to be doubted; without
            it the model that the robot has in the store (modelgap models), where the
            logs are runs of it or --store is given.
        verbose: List the effects that these logs could not tell apart.
    """
    request = Diagnose(
        logs=logs,
        robot=robot,
        held_out=holdout,
        baseline=baseline,
        declared=parse_declared(declared),
        columns=map,
        null=null,
        store=store,
        trust_log=trust_log,
    )
    words = Wanted(model, store, (*logs, *holdout), _instead(baseline, declared))
    choice = choose_for(robot, words)
    request = replace(request, model=choice.diagnosis)
    files = named_files({"--report": report, "--json": json})
    check_writable(files, read_files((*logs, *baseline, *holdout, robot), map, null))
    console = console_beside(json)
    read = steps.read_logs(request)
    say(console, *read.lines[:1], *choice.lines, *read.lines[1:])
    stored = steps.as_stored(read)
    with progress_bar() as progress:
        found = steps.diagnose(request, stored or read, progress)
    # Those of the logs were printed before the work.
    say(console, *found.notes[len(read.lines) :])
    text = json_text(verdict.to_json(found.verdict))
    contents = {"--json": text}
    if report:
        contents["--report"] = _page(found, request, report)
    write_all({path: contents[option] for option, path in files.items()})
    terminal.print_diagnosis(found, console, verbose)
    say(console, *(f"wrote {path}" for path in files.values()))
    if stored:
        id, _ = steps.keep(request, stored, found)
        say(console, f"stored as a diagnosis: modelgap show {id}")
    if json == STDOUT:
        print(text, end="")


def _instead(baseline: tuple[str, ...], declared: str | None) -> str | None:
    """Return the option that says by itself what the nominal model is."""
    if baseline:
        return "--baseline"
    return None if declared is None else "--declared"


def _page(found: "result.Diagnosis", request: Diagnose, path: str) -> str:
    return page.page_with_motion(found, origin.of_request(request, path))
