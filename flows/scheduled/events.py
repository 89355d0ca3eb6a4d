"""What flows tell each other: events that start the flows of prefect.yaml.

Sent by the flow layer after a commit; the store knows nothing of them.
"""

from collections.abc import Sequence

from prefect.events import emit_event

from flows.scheduled.stages import Alarm

COMMITTED, ALARM = "modelgap.run.committed", "modelgap.monitor.alarm"
STORE = "modelgap.store"
_MOST = 1000  # ids in one event; the server refuses more than 1.5 MB


def runs_committed(ids: Sequence[str]) -> None:
    """Tell that runs are in the store; one event for a batch of them.

    Args:
        ids: Their ids.
    """
    for start in range(0, len(ids), _MOST):
        part = list(ids[start : start + _MOST])
        _tell(COMMITTED, {"run_ids": part})


def alarm_raised(alarm: Alarm) -> None:
    """Tell that the monitoring of runs raised an alarm.

    Args:
        alarm: What was found.
    """
    about = {"record": alarm.record}
    _tell(ALARM, about | {"run_ids": list(alarm.runs), "good_ids": list(alarm.good)})


def _tell(name: str, payload: dict) -> None:
    emit_event(name, resource={"prefect.resource.id": STORE}, payload=payload)
