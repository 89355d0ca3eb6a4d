"""modelgap experiment, campaign, trajectory, demo, validate and monitor."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from rich.console import Console

from flows.cli import FASTEST, LONGEST, MOST_PERIODS, SEEDS, Outputs, check_option_range
from flows.outputs import list_input_files, print_plain, show_progress_bar
from flows.requests import (
    File,
    Flag,
    Hertz,
    Json,
    Monitor,
    Number,
    Program,
    RobotRequest,
    RobotWord,
    Seconds,
    Store,
    Validate,
    Where,
)
from flows.settings import resolve_store_folder
from residual.errors import InputError, RunError

if TYPE_CHECKING:
    from flows.steps.experiment import PlannedExperiment

DryRun = Annotated[
    Flag,
    Parameter(
        help="Run nothing; plan the motions and list what would run, what is stored, "
        "and what breaks a limit of the arm."
    ),
]


def experiment(spec: str, /, *, store: Store = None, dry_run: DryRun = False) -> None:
    """Run one experiment on the simulated arm and store it.

    ```
    modelgap experiment SPEC.toml
    modelgap experiment SPEC.toml --dry-run
    ```

    The same spec is the same run, and a stored run is not repeated. A spec that breaks
    a limit of the arm, or a simulation that diverges, stores nothing.

    Args:
        spec: SPEC.toml with robot, trajectory, plant with hidden effects, and rates.
    """
    from flows.specs import load_spec
    from flows.steps import experiment as steps
    from warehouse.remote_store import format_store_name

    place, console = resolve_store_folder(store), Console()
    (planned,) = steps.plan_experiments([(spec, load_spec(spec))], place)
    _list([planned], console, dry_run)
    if not (dry_run or planned.stored):
        steps.simulate_and_store(planned.spec, place)
        print_plain(
            console, f"stored in {format_store_name(place)}: modelgap show {planned.run_id}"
        )


def campaign(
    spec: str, /, *, store: Store = None, dry_run: DryRun = False, json: Json = None
) -> None:
    """Run many experiments on the simulated arm, on all cores.

    ```
    modelgap campaign CAMPAIGN.toml --dry-run
    modelgap campaign CAMPAIGN.toml
    ```

    A campaign is a SPEC.toml with [grid], every combination of some lists, or [random],
    a number of random draws. The same command completes an interrupted campaign. An
    experiment that fails is reported and stops no other.

    Args:
        spec: The campaign file.
    """
    from flows.specs import load_campaign
    from flows.steps import experiment as steps
    from warehouse.remote_store import format_store_name

    out = Outputs({"--json": json}, [Path(spec)])
    place, console = resolve_store_folder(store), out.console
    entries = load_campaign(spec)
    planned = steps.plan_experiments(entries, place, Path(spec).stem)
    if sealed := [axis for axis in entries[0].sealed if axis != "seed"]:
        out.say(f"sealed: {', '.join(sealed)}")
    refused = _list(planned, console, True) if dry_run else {}
    failing = len(refused)
    missing = sum(not p.stored for p in planned)
    count_text = f"{missing} to run, {len(planned) - missing} in {format_store_name(place)}"
    print_plain(console, f"{count_text}; {failing} will fail" if failing else count_text)
    if dry_run:
        summary = steps.CampaignSummary(tuple(planned), refused)
        out.write(document=lambda: steps.build_campaign_document(summary, done=False))
        out.finish()
        return
    steps.store_campaign(planned, spec, place)
    with show_progress_bar() as bar:
        summary = steps.run_campaign_experiments(planned, place, bar)
    out.write(document=lambda: steps.build_campaign_document(summary))
    print_plain(console, *(f"failed: {why}" for why in summary.failed.values()))
    failed = len(summary.failed)
    out.finish(f"{missing - failed} stored, {failed} failed, {summary.seconds} s")
    if failed:
        raise RunError(steps.advise_on_failures(summary))


def _list(planned: list["PlannedExperiment"], console: Console, rehearsed: bool) -> dict[str, str]:
    """List experiments, with their motions planned; returns why some will fail."""
    from flows.steps.experiment import explain_infeasible_motion

    failing = {}
    with show_progress_bar() as tell:
        for number, each in enumerate(planned):
            why = None
            if rehearsed and not each.stored:
                tell(f"planning {each.label}", number / len(planned))
                why = explain_infeasible_motion(each)
            word = "is there" if each.stored else "fails" if why else "to run"
            print_plain(console, f"{each.run_id}  {word:8}  {each.label}")
            if why:
                failing[each.run_id] = why
                print_plain(console, f"  {why}")
    return failing


def validate(
    *runs: Annotated[str, Parameter(name="RUN")],
    request: Validate = Validate(),
    where: Where = None,
    report: File = None,
) -> None:
    """Validate a model on stored runs, without a fit.

    ```
    modelgap validate 3f2a
    modelgap validate 3f2a --window 0.1
    modelgap validate 3f2a 77c0 --model 8904
    ```

    Open loop: deviation of the nominal model from the measured motion under the logged
    torque, per window. Feed-forward, on simulated runs: tracking error with the torque
    of the model and with that of the arm itself. For every model: torque from motion,
    acceleration from torque, and a positive mass matrix. Errors are root mean squares
    per joint, and are stored.

    With an adopted model, or with --model, the simulated arm of a run is also driven
    along the reference of the run, once by the torque of each model, to compare the
    tracking error of each joint before and after. Take runs that no model was fitted
    to.

    Args:
        runs: Ids of runs; the beginning is enough.
        report: HTML page to write.
    """
    from flows.inputs import query_run_ids
    from flows.report import experiments, print_parts
    from flows.steps import validate as trial
    from warehouse.remote_store import format_store_name

    out, place = Outputs({"--report": report}), resolve_store_folder(request.store)
    console, found = out.console, {}
    runs = (*runs, *query_run_ids(request.store, where))
    if not runs:
        raise InputError("No run to validate on. Give one: modelgap validate RUN")
    for run in runs:
        id, made = trial.validate(replace(request, run=run, store=place))
        found[run] = made
        stored = f"stored in {format_store_name(place)}: modelgap show {id}"
        parts = experiments.build_validation_parts(run, made)
        print_parts(console, *parts, *made.notes, stored)
    out.write({"--report": lambda: experiments.render_validation_page(found)})
    out.finish()


@dataclass(frozen=True, slots=True)
class Trajectory(RobotRequest):
    """Plan a motion.

    Attributes:
        duration: Length in seconds, up to 600.
        periods: Number of repetitions within the duration.
        seed: Seed of the motion.
        rate: Samples per second of the CSV.
    """

    robot: RobotWord = "irb140"
    duration: Seconds = 20.0
    periods: Number = 2
    seed: Number = 0
    rate: Hertz = 250.0


def trajectory(
    family: str,
    /,
    *,
    request: Trajectory = Trajectory(),
    out: Annotated[Program, Parameter(name=("--out", "--csv"))] = None,
) -> None:
    """Plan a motion within the limits of a robot.

    Prints the use of each limit and the excitation of the model parameters. The motion
    respects range, speed, acceleration, torque of the nominal model, the floor and
    self-collision, also between the samples.

    ```
    modelgap trajectory fourier
    modelgap trajectory welding --robot arm.urdf --duration 30 --out program.csv
    ```

    Args:
        family: fourier (optimised excitation), cyclic (spray painting), welding (seams
            with air moves) or move_stop_move (pick and place with dwells).
    """
    from flows.inputs import load_command_robot
    from flows.report import print_parts
    from flows.report.experiments import build_motion_parts
    from flows.steps.experiment import format_reference_csv
    from sim.engine.plant_records import TrajectorySpec
    from sim.trajectories import plan_reference_motion
    from sim.trajectories.excitation import compute_limit_usage

    outputs = Outputs({"--out": out}, list_input_files([request.robot]))
    rate = request.rate
    check_option_range("--duration", request.duration, 0.1, LONGEST)
    check_option_range("--periods", request.periods, 1, MOST_PERIODS)
    check_option_range("--rate", rate, 1, FASTEST)
    check_option_range("--seed", request.seed, 0, SEEDS)
    arm = load_command_robot(request.robot)
    spec = TrajectorySpec(family, request.duration, request.periods, request.seed)
    motion = plan_reference_motion(arm, spec, rate)
    # Before anything is printed, which may go into a pipe that closes.
    outputs.write({"--out": lambda: format_reference_csv(motion)})
    print_parts(
        outputs.console,
        *build_motion_parts(arm, motion, spec, rate, compute_limit_usage(arm, motion)),
    )
    outputs.finish()


def demo(
    *,
    seed: Number = 7,
    effect: Annotated[str | None, Parameter(metavar="EFFECT")] = None,
    store: Store = None,
    # As sim.engine.plant_records.BACKGROUNDS, which loads numerics.
    background: Annotated[
        Literal["clean", "workshop", "worn"], Parameter(metavar="NAME")
    ] = "clean",
) -> None:
    """Find the hidden effect of a simulated arm.

    Runs six experiments of three motion families in a physics engine, and two held-out
    ones; diagnoses the stored logs, writes a report, then opens the sealed truth and
    prints it next to the verdict. Stored runs are not repeated.

    ```
    modelgap demo
    modelgap demo --effect spring --seed 3
    ```

    Args:
        seed: Seed of the arm, the motions, the noise, and of the hidden effect.
        effect: Effect to hide, default drawn from the seed; "none" hides nothing.
            Its size is large enough for the motions to show it.
        background: Small effects of all joints beside it: none, those of an arm in use,
            or twice as much.
    """
    from flows.report import print_parts
    from flows.report.diagnosis import build_truth_parts, print_diagnosis
    from flows.report.store_index import parse_hidden_effects, store_demo_page
    from flows.steps import demo as demonstration
    from flows.steps.diagnose import build_diagnose_request, diagnose_stored_runs
    from flows.storage import read_outcome
    from warehouse.remote_store import format_store_name

    place, console = resolve_store_folder(store), Console()
    check_option_range("--seed", seed, 0, SEEDS)
    # Before anything is started, so that a wrong word fails at once.
    specs = demonstration.build_demo_specs(seed, effect, background)
    arm = f"the simulated {demonstration.ROBOT}, background {background}"
    print_plain(console, f"{len(specs)} experiments on {arm}, into {format_store_name(place)}")
    with show_progress_bar() as progress:
        runs = demonstration.run_experiments(specs, place, progress)
        ids = diagnose_stored_runs(build_diagnose_request(runs, place), progress)
        hidden = demonstration.read_hidden_effects(runs, place)
        page = store_demo_page(ids, hidden, place)
    outcome = read_outcome(place, ids[1])
    print_diagnosis(outcome, console)
    truth = build_truth_parts(parse_hidden_effects(hidden), outcome.verdict)
    print_parts(console, *truth, wrapped=True)
    print_plain(console, f"\nreport: {page}")


def monitor(
    model: str,
    /,
    *runs: Annotated[str, Parameter(name="RUN")],
    request: Monitor = Monitor(),
    nominal: Flag = False,
) -> None:
    """Monitor the sensors of runs, with limits from healthy runs.

    ```
    modelgap monitor irb140 3f2a --calibrate 01ab 02cd 03ef 04aa
    modelgap monitor 77e0 3f2a 4b1c
    ```

    Reports time, joint and sensor of encoders that freeze, jump or drift, and of torque
    sensors with a bias, a lost scale or spikes. In a closed loop a slow drift of an
    encoder does not show: the arm follows it (docs/monitoring.md).

    Args:
        model: Id of a diagnosis, or a robot (built-in name, file, folder) for its
            adopted model (modelgap models), else its nominal model fitted to the
            healthy runs.
        runs: Ids of the runs, or their beginnings.
        nominal: Use the nominal model of the robot, also where one is adopted.
    """
    from flows.report import print_parts
    from flows.report.experiments import build_alarm_table, describe_alarms
    from flows.steps import monitor as monitoring
    from flows.steps.model_choice import choose_monitor_model
    from warehouse.remote_store import format_store_name

    place = resolve_store_folder(request.store)
    console, choice = Console(), choose_monitor_model(model, place, nominal, runs)
    print_plain(console, *choice.lines)
    request = replace(request, model=choice.diagnosis or model, runs=runs, store=place)
    id, outcome, watched = monitoring.monitor(request)
    if any(outcome.alarms.values()):
        print_parts(console, build_alarm_table(outcome, watched))
    print_plain(console, describe_alarms(outcome), *outcome.notes)
    print_plain(console, f"stored in {format_store_name(place)}: modelgap show {id}")
