"""modelgap next: the motion that would settle what a verdict leaves open."""

from dataclasses import replace
from pathlib import Path

from flows.cli.app import FASTEST, SEEDS, Outputs, check_between
from flows.inputs.read import is_run
from flows.outputs import progress_bar, read_files
from flows.report.console import show
from flows.report.next import comparison, nothing_open, told
from flows.report.words.verdict import sentences
from flows.requests import File, Hertz, Log, Next
from flows.steps.experiment import as_csv
from flows.steps.next import open_verdict, rank_motions
from residual.verdict.document import to_json
from sim.trajectories import make_reference

_PLAIN = Next()


def next_(
    verdict: str,
    /,
    *logs: Log,
    request: Next = _PLAIN,
    rate: Hertz = 250.0,
    out: File = None,
    json: File = None,
) -> None:
    """Choose the motion that tells apart what a verdict leaves open.

    The logs of the verdict are looked at once more; then Fourier motions and moves,
    within the limits of the arm, are ranked by how soon each is sure which of the
    rivals is true. Of a diagnosis in the store all is known:

    ```
    modelgap next 3f2a --out program.csv
    ```

    Of the JSON of a verdict, its logs and robot have to be named:

    ```
    modelgap next out.json A.csv B.csv --robot arm.urdf --out program.csv
    ```

    Args:
        verdict: Id of a diagnosis in the store (the beginning is enough), or the file
            of modelgap diagnose --json.
        logs: Logs of that file: CSV, Parquet, ROS bag or MCAP, or the id of a run.
        rate: Samples per second of the program.
        out: CSV for a controller: t (s), q1... (rad), qd1... (rad/s), qdd1...
            (rad/s^2).
        json: File for the verdict with its next_experiment filled in; "-" prints it
            and nothing else.
    """
    request = replace(request, verdict=verdict, logs=logs)
    words = (*request.logs, *request.baseline, *request.held_out)
    read = [] if is_run(verdict) else [Path(verdict)]
    options = {"--out": out, "--json": json}
    outputs = Outputs(options, read + read_files(words, request.columns))
    check_between("--rate", rate, 1, FASTEST)
    check_between("--seed", request.seed, 0, SEEDS)
    with progress_bar() as progress:
        opened = open_verdict(request, progress)
        found = rank_motions(
            opened.question, opened.robot, request.seconds, request.seed, progress
        )
    outputs.say(*opened.lines)
    if not opened.same:
        headline = sentences(opened.found.verdict)[0]
        outputs.say(f"Warning: these logs say another thing than {verdict}: {headline}")
    if found is None or found.best.seen.hopeless:
        outputs.say(*nothing_open(opened, found))
        return
    plan = found.document(Path(out).name if out else None)
    outputs.write(
        {"--out": lambda: as_csv(make_reference(opened.robot, found.best.spec, rate))},
        lambda: to_json(replace(opened.verdict, next_experiment=plan)),
    )
    show(outputs.console, *told(found), comparison(found))
    outputs.finish()
