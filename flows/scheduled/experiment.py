"""One experiment as a Prefect flow."""

from prefect import flow

from flows.scheduled import tasks
from flows.settings import store_folder


@flow(name="experiment", flow_run_name="experiment {spec}", timeout_seconds=tasks.HOUR)
def experiment(spec: str, store: str | None = None) -> str:
    """Run one experiment on the simulated arm and store it.

    Args:
        spec: SPEC.toml.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The id of its run.
    """
    return tasks.experiment(spec, str(store_folder(store)))
