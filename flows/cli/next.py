"""modelgap next."""

from dataclasses import replace
from pathlib import Path

from flows.cli.app import FASTEST, SEEDS, Outputs, check_option_range
from flows.outputs import list_input_files, show_progress_bar
from flows.requests import File, Hertz, Log, Next

_DEFAULT = Next()


def next_(
    verdict: str,
    /,
    *logs: Log,
    request: Next = _DEFAULT,
    rate: Hertz = 250.0,
    out: File = None,
    json: File = None,
) -> None:
    """Choose the motion that separates the open rivals of a verdict.

    Diagnoses the logs of the verdict again, then ranks Fourier motions and moves within
    the limits of the arm by the time after which they decide between the rivals. For a
    stored diagnosis:

    ```
    modelgap next 3f2a --out program.csv
    ```

    For the JSON file of a verdict, with its logs and its robot:

    ```
    modelgap next out.json A.csv B.csv --robot arm.urdf --out program.csv
    ```

    Args:
        verdict: Id of a stored diagnosis, or its beginning, or a file of modelgap
            diagnose --json.
        logs: Logs of that file: CSV, Parquet, ROS bag or MCAP, or ids of runs.
        rate: Samples per second of the program.
        out: CSV file for a controller: t (s), q1... (rad), qd1... (rad/s), qdd1...
            (rad/s^2).
        json: File for the verdict with its next_experiment; "-" prints it alone.
    """
    from flows.inputs.read import is_run_id
    from flows.report.document import print_parts
    from flows.report.experiments import (
        build_ranking_table,
        describe_best_motion,
        explain_no_experiment,
    )
    from flows.report.sentences import list_headline_sentences
    from flows.steps.experiment import format_reference_csv
    from flows.steps.next import rank_motions, reopen_diagnosis
    from residual.verdict.document import to_json
    from sim.trajectories import plan_reference_motion

    request = replace(request, verdict=verdict, logs=logs)
    words = (*request.logs, *request.baseline, *request.held_out)
    read = [] if is_run_id(verdict) else [Path(verdict)]
    options = {"--out": out, "--json": json}
    outputs = Outputs(options, read + list_input_files(words, request.columns))
    check_option_range("--rate", rate, 1, FASTEST)
    check_option_range("--seed", request.seed, 0, SEEDS)
    with show_progress_bar() as progress:
        opened = reopen_diagnosis(request, progress)
        ranking = rank_motions(
            opened.question, opened.robot, request.seconds, request.seed, progress
        )
    outputs.say(*opened.lines)
    if not opened.reproduced:
        headline = list_headline_sentences(opened.diagnosis.verdict)[0]
        outputs.say(f"Warning: these logs say another thing than {verdict}: {headline}")
    if ranking is None or ranking.best.outlook.separates_nothing:
        outputs.say(*explain_no_experiment(opened, ranking))
        return
    plan = ranking.document(Path(out).name if out else None)
    outputs.write(
        {
            "--out": lambda: format_reference_csv(
                plan_reference_motion(opened.robot, ranking.best.spec, rate)
            )
        },
        lambda: to_json(replace(opened.verdict, next_experiment=plan)),
    )
    print_parts(outputs.console, *describe_best_motion(ranking), build_ranking_table(ranking))
    outputs.finish()
