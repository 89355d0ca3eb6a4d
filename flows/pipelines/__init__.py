"""Prefect: tasks and flows over the steps, what they show people, proposals that wait.

To be imported under `flows.settings.build_prefect_environment`.
"""

from pathlib import Path

from prefect.client.orchestration import SyncPrefectClient
from prefect.client.schemas.filters import FlowFilter, FlowRunFilter
from prefect.client.schemas.objects import State, StateType

from warehouse.queries import query_store_rows

# By diagnosis: the first adoption of its robot after it was last proposed.
_SETTLED = """
    WITH proposed AS (
        SELECT parent AS diagnosis_id, max(created) AS proposed
        FROM reports JOIN lineage ON child = report_id AND role = 'diagnosis'
        WHERE kind = 'proposal' GROUP BY ALL
    )
    SELECT p.diagnosis_id AS proposal, a.*
    FROM proposed p JOIN diagnoses d USING (diagnosis_id)
    JOIN adoptions a ON a.robot = d.robot AND a.serial IS NOT DISTINCT FROM d.serial
        AND a.created > proposed
    QUALIFY row_number() OVER (PARTITION BY proposal ORDER BY a.adoption_id) = 1
"""


def cancel_settled_proposals(client: SyncPrefectClient, store: Path) -> int:
    """Cancel the runs of `propose` whose robot got another model; return how many.

    Nobody can answer them any more. The reason is the message of their state.
    """
    waiting = client.read_flow_runs(
        flow_filter=FlowFilter(name={"any_": ["propose"]}),
        flow_run_filter=FlowRunFilter(state={"type": {"any_": ["PAUSED"]}}),
    )
    rows = query_store_rows(store, _SETTLED) if waiting else []
    settled, count = {row["proposal"]: row for row in rows}, 0
    for run in waiting:
        if (row := settled.get(run.parameters.get("diagnosis"))) is None:
            continue
        note = f": {row['note']}" if row["note"] else ""
        reason = (
            f"Settled by adoption {int(row['adoption_id'])} of {row['robot']} "
            f"({row['action']} by {row['who']}{note})."
        )
        state = State(type=StateType.CANCELLED, name="Cancelled", message=reason)
        client.set_flow_run_state(run.id, state, force=True)
        count += 1
    return count
