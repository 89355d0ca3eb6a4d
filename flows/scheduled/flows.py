"""All Prefect flows: their order of tasks, and nothing else.

To be imported under `flows.settings.quiet_prefect`; prefect.yaml says when each is
started.
"""

from functools import partial

from prefect import flow, get_run_logger
from prefect.runtime import flow_run

from flows.requests import Campaign
from flows.scheduled import loop, tasks
from flows.scheduled import project as projects
from flows.settings import HEALTHY, store_folder

_LIMIT = 12 * tasks.HOUR
_NIGHT = 24 * tasks.HOUR
_alone = partial(flow, timeout_seconds=_LIMIT)

# One step by itself; a night takes some of them as its tasks.
experiment = flow(
    tasks.experiment, flow_run_name="experiment {spec}", timeout_seconds=tasks.HOUR
)
identify = _alone(tasks.identify, flow_run_name="identify {fit}")
calibrate = _alone(tasks.calibrate, flow_run_name="calibrate {runs}")
validate = _alone(tasks.validate, flow_run_name="validate {runs}")
rerun = _alone(tasks.rerun, flow_run_name="rerun {id}")
verify = _alone(tasks.verify)
_identify, _calibrate, _validate = (
    tasks.task(step, task_run_name=step.__name__, tags=["analysis"])
    for step in (tasks.identify, tasks.calibrate, tasks.validate)
)


@flow(name="nightly", flow_run_name="nightly {campaign_file}", timeout_seconds=_NIGHT)
def nightly(
    campaign_file: str = "examples/nightly.toml",
    held_out: str = "welding",
    store: str | None = None,
    runner: str | None = None,
    trust_network: bool = False,
    auto: bool = False,
    seed: int | None = None,
) -> str:
    """Run new motions of the night; identify, calibrate, validate, diagnose, report.

    What the diagnosis finds beyond the model that the robot has is proposed as its
    next model; the flow `propose` waits for the answer, this one does not.

    Args:
        campaign_file: The campaign; its seed is replaced by the next one.
        held_out: Kind of motion that is not fitted.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        runner: threads or dask://HOST:PORT; else $MODELGAP_RUNNER.
        trust_network: Whether that host may be another machine.
        auto: Whether to adopt it without asking.
        seed: Seed of the motions, to repeat a night; without it the time of the
            schedule to the second, so that every start has motions of its own, and one
            that is tried again the same. It is in the record of every run.
    """
    place = str(store_folder(store))
    where = (runner, trust_network, place)
    seed = _second() if seed is None else seed
    get_run_logger().info(f"to repeat this night: seed {seed}")
    runs = tasks.campaign(Campaign(campaign_file, held_out, seed, *where))
    fit, proof = runs["fit"], runs["held_out"]
    _identify(fit, proof, place)
    _calibrate([*fit, *proof], place)
    _validate(proof or fit, store=place)
    ids = tasks.diagnose(runs, place, loop.model_in_force(runs, place))
    page = tasks.report(ids, place)
    loop.adopt_or_propose(ids[0], place, auto)
    return page


@flow(name="campaign", flow_run_name="campaign {campaign_file}", timeout_seconds=_NIGHT)
def campaign(
    campaign_file: str,
    seed: int | None = None,
    store: str | None = None,
    runner: str | None = None,
    trust_network: bool = False,
) -> list[str]:
    """Run many experiments on the simulated arm over all cores.

    Args:
        campaign_file: The campaign.
        seed: Replaces its seed.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        runner: threads or dask://HOST:PORT; else $MODELGAP_RUNNER.
        trust_network: Whether that host may be another machine.
    """
    place = str(store_folder(store))
    asked = Campaign(campaign_file, "", seed, runner, trust_network, place)
    return tasks.campaign(asked)["fit"]


@flow(name="diagnose", flow_run_name="diagnose {runs}", timeout_seconds=_LIMIT)
def diagnose(
    runs: list[str],
    held_out: list[str] | None = None,
    good: list[str] | None = None,
    model: str | None = None,
    store: str | None = None,
    project: str | None = None,
    alarm: bool = False,
) -> str | None:
    """Find what the model of an arm lacks, and write the report.

    What an alarm asks for is diagnosed once: runs of a robot of a project with all
    that is new of it, others not again where a diagnosis speaks of them already; and
    against the healthy runs of the arm, where there are such.

    Args:
        runs: Ids of the runs to diagnose.
        held_out: Ids of the runs for the proof.
        good: Ids of healthy runs of the arm.
        model: Id of the diagnosis whose model is the nominal one; none unless given.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        project: Folder of the project, None for none.
        alarm: Whether an alarm asks.

    Returns:
        The page; None where another diagnosis speaks of the runs.
    """
    place = str(store_folder(store))
    if alarm:
        robot = projects.robot_of(project, runs) if project else None
        if project and robot:
            return projects.diagnosed_new(project, robot)
        if tasks.diagnosed_already(runs, place):
            return None
        good = tasks.healthy(runs, good or [], place)
    roles = {"fit": runs, "held_out": held_out or [], "baseline": good or []}
    return tasks.report(tasks.diagnose(roles, place, model), place)


@flow(name="monitor", flow_run_name="monitor", timeout_seconds=_LIMIT)
def monitor(
    runs: list[str],
    model: str | None = None,
    good: list[str] | None = None,
    store: str | None = None,
    project: str | None = None,
) -> list[str]:
    """Watch the sensors of new runs; an alarm starts the flow `diagnose`.

    Args:
        runs: Ids of the runs.
        model: Id of a diagnosis, or a robot; the arm's latest diagnosis unless given.
        good: Ids of the healthy runs; unless given those with the tag of healthy runs,
            and where these are too few those of the diagnosis.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        project: Folder of the project, which says that tag; None for none.

    Returns:
        The id of the record, none where there was nothing to compare with.
    """
    tag = projects.tag_of(project, runs) if project else HEALTHY
    return tasks.watch(runs, model, good or [], str(store_folder(store)), tag)


@flow(name="report", flow_run_name="report {diagnosis}", timeout_seconds=_LIMIT)
def report(diagnosis: str, proof: str, store: str | None = None) -> str:
    """Write the page of a diagnosis again.

    Args:
        diagnosis: Its id.
        proof: Id of the validation with its curves.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    return tasks.report([diagnosis, proof], str(store_folder(store)))


def _second() -> int:
    """The time of the schedule as a seed: 20261122020000 for two in the morning."""
    return int(f"{flow_run.scheduled_start_time:%Y%m%d%H%M%S}")
