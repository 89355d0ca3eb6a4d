"""What flows tell each other: events that start the flows of prefect.yaml.

Sent by the flow layer after a commit; the store knows nothing of them.
"""

from collections.abc import Sequence

from prefect.events import emit_event

from flows.project.deployments import (
    ALARM,
    COMMITTED,
    PROPOSED,
    STORE,
    STORED,
    resource,
)

_MOST = 1000  # ids in one event; the server refuses more than 1.5 MB


def runs_committed(ids: Sequence[str]) -> None:
    """Tell that runs are in the store; one event for a batch of them.

    Args:
        ids: Their ids.
    """
    for start in range(0, len(ids), _MOST):
        part = list(ids[start : start + _MOST])
        _tell(COMMITTED, {"run_ids": part})


def alarm_raised(record: str, runs: Sequence[str], good: Sequence[str]) -> None:
    """Tell that the monitoring of runs raised an alarm.

    Args:
        record: Id of the monitoring.
        runs: Ids of the runs with an alarm.
        good: Ids of the runs that they were judged by.
    """
    about = {"record": record, "run_ids": list(runs), "good_ids": list(good)}
    _tell(ALARM, about)


def model_proposed(diagnosis: str) -> None:
    """Tell that the model of a diagnosis may be that of its robot.

    Args:
        diagnosis: Its id.
    """
    _tell(PROPOSED, {"diagnosis": diagnosis})


def logs_stored(robot: str) -> None:
    """Tell that an inbox has stored logs of a robot.

    Args:
        robot: Its name in the project.
    """
    _tell(STORED, {"robot": robot}, resource(robot))


def _tell(name: str, payload: dict, about: str = STORE) -> None:
    emit_event(name, resource={"prefect.resource.id": about}, payload=payload)
