"""The stages on runs of the store as Prefect flows, to be started one by one."""

from prefect import flow

from flows.scheduled import tasks
from flows.settings import store_folder

_LIMIT = 12 * tasks.HOUR


@flow(name="identify", flow_run_name="identify {fit}", timeout_seconds=_LIMIT)
def identify(
    fit: list[str], held_out: list[str] | None = None, store: str | None = None
) -> None:
    """Identify the parameters of an arm.

    Args:
        fit: Ids of the runs to fit.
        held_out: Ids of the runs for the proof.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    runs = {"fit": fit, "held_out": held_out or []}
    tasks.identify(runs, str(store_folder(store)))


@flow(name="calibrate", flow_run_name="calibrate {runs}", timeout_seconds=_LIMIT)
def calibrate(runs: list[str], store: str | None = None) -> list[str]:
    """Fit look-up tables to what the model of an arm leaves.

    Args:
        runs: Ids of the runs.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The ids of model and validation.
    """
    return tasks.calibrate({"fit": runs, "held_out": []}, str(store_folder(store)))


@flow(name="validate", flow_run_name="validate {runs}", timeout_seconds=_LIMIT)
def validate(
    runs: list[str], window: float = 0.25, store: str | None = None
) -> list[str]:
    """Try the nominal model on runs.

    Args:
        runs: Ids of the runs.
        window: Length of the windows of the open loop [s].
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The ids of the validations.
    """
    return tasks.validate(runs, window, str(store_folder(store)))


@flow(name="diagnose", flow_run_name="diagnose {runs}", timeout_seconds=_LIMIT)
def diagnose(
    runs: list[str],
    held_out: list[str] | None = None,
    good: list[str] | None = None,
    store: str | None = None,
) -> str:
    """Find what the model of an arm lacks, and write the report.

    Args:
        runs: Ids of the runs to diagnose.
        held_out: Ids of the runs for the proof.
        good: Ids of runs of the arm in good order.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The page.
    """
    place = str(store_folder(store))
    roles = {"fit": runs, "held_out": held_out or [], "baseline": good or []}
    return tasks.report(tasks.diagnose(roles, place), place)


@flow(name="monitor", flow_run_name="monitor", timeout_seconds=_LIMIT)
def monitor(
    runs: list[str],
    model: str | None = None,
    good: list[str] | None = None,
    store: str | None = None,
) -> list[str]:
    """Watch the sensors of new runs; an alarm starts the flow `diagnose`.

    Args:
        runs: Ids of the runs.
        model: Id of a diagnosis, or a robot; the arm's latest diagnosis unless given.
        good: Ids of the runs in good order; those of the diagnosis unless given.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The id of the record, none where there was nothing to compare with.
    """
    return tasks.watch(runs, model, good or [], str(store_folder(store)))


@flow(name="report", flow_run_name="report {diagnosis}", timeout_seconds=_LIMIT)
def report(diagnosis: str, proof: str, store: str | None = None) -> str:
    """Write the page of a diagnosis again.

    Args:
        diagnosis: Its id.
        proof: Id of the validation with its curves.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The page.
    """
    return tasks.report([diagnosis, proof], str(store_folder(store)))


@flow(name="rerun", flow_run_name="rerun {id}", timeout_seconds=_LIMIT)
def rerun(id: str, verify: bool = True, store: str | None = None) -> bool:
    """Make a record again from its manifest, and compare the values bit for bit.

    Args:
        id: Its id.
        verify: Whether to compare only.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        Whether all values are the same bits.
    """
    return tasks.rerun(id, verify, str(store_folder(store)))
