"""The SQL of the views over the catalogue."""

from collections.abc import Iterable

import pyarrow as pa

from warehouse.view_schema import COMPUTED, KINDS, SIGNALS, VIEWS, RecordKind, ViewColumn

# Metrics are named after what they are of; a calibration's after their scheme.
_UNIT = """
    CASE WHEN metric IN ('held_out', 'filtered', 'moving') THEN '%'
         WHEN starts_with(metric, 'rmsec') OR starts_with(metric, 'rmsev') THEN '%'
         WHEN ends_with(metric, '_q') THEN 'rad'
         WHEN ends_with(metric, '_qd') THEN 'rad/s'
         WHEN ends_with(metric, '_qdd') THEN 'rad/s^2'
         WHEN ends_with(metric, '_tau') THEN 'N m'
         WHEN metric = 'energy' THEN 'J'
    END
"""


def build_catalogue_views() -> dict[str, str]:
    """Return the query behind each view that is made of catalogue rows, by name."""
    views = {"catalogue.arms": _arms()}
    views |= {name: _rows(kind) for name, kind in KINDS.items() if name != "runs"}
    views["runs"] = (
        f"SELECT {_listed(VIEWS['runs'][:-2])}, "
        "run_id IN (FROM catalogue.quarantine) AS quarantined, "
        "run_id IN (FROM catalogue.opened) AS opened FROM catalogue.runs"
    )
    views["channels"] = """
        SELECT run_id, concat(signal, joint) AS channel, unit, joint
        FROM (
            SELECT run_id, signal, unit,
                   unnest(CASE WHEN per_joint THEN range(1, dof + 1) ELSE [NULL] END)
                       ::INTEGER AS joint
            FROM (SELECT run_id, dof, unnest(signals) AS signal FROM catalogue.runs)
            JOIN catalogue.signals USING (signal)
        )
    """
    # The number decides, not the clock of who wrote it.
    views["adopted"] = (
        f"SELECT {_listed(VIEWS['adopted'])} FROM catalogue.adoptions QUALIFY "
        "row_number() OVER (PARTITION BY robot, serial ORDER BY adoption_id DESC) = 1"
    )
    views["verdicts"] = _verdicts()
    for view in dict.fromkeys(v for kind in KINDS.values() for v in kind.nested_views):
        kinds = [kind for kind in KINDS.values() if view in kind.nested_views]
        parts = [_unnested(view, kind.name, kind.key) for kind in kinds]
        views[view] = " UNION ALL ".join(parts)
    views["errors"] = f"""
        SELECT e.* REPLACE (coalesce(e.trajectory, r.trajectory, motion) AS trajectory),
               {_UNIT} AS unit, coalesce(r.robot, a.robot) AS robot,
               coalesce(r.serial, a.serial) AS serial,
               coalesce(r.recorded_at, a.recorded_at) AS recorded_at
        FROM ({views["errors"]}) e
        LEFT JOIN catalogue.runs r USING (run_id)
        LEFT JOIN catalogue.arms a ON a.id = e.source_id
    """
    return views


def _rows(kind: RecordKind) -> str:
    """Return the query of a kind of record, and of which arm and time it is."""
    columns = _listed(VIEWS[kind.name])
    computed = COMPUTED.get(kind.name, ())
    if not computed:
        return f"SELECT {columns} FROM catalogue.{kind.name}"
    more = ", ".join(f"arm.{column.name}" for column in computed)
    shown = "own.*"
    if any(column.name == "serial" for column in VIEWS[kind.name]):
        shown += " REPLACE (coalesce(own.serial, arm.serial) AS serial)"
    return (
        f"SELECT {shown}, {more} "
        f"FROM (SELECT {columns} FROM catalogue.{kind.name}) own "
        f"LEFT JOIN catalogue.arms arm ON arm.id = own.{kind.key}"
    )


def _arms() -> str:
    """A row per record: its robot, serial number, and when its last run was recorded.

    By the runs that it was fitted to, where there are such; and of held-out runs the
    motion, where that is one.
    """
    kinds = [KINDS[name] for name in COMPUTED if name in KINDS]
    parts = " UNION ALL ".join(
        f"SELECT {kind.key} AS id, unnest(lineage, recursive := true) FROM catalogue.{kind.name}"
        for kind in kinds
    )
    return f"""
        SELECT id, any_value(robot) FILTER (counts) AS robot,
               CASE WHEN bool_and(serial IS NOT NULL) FILTER (counts)
                         AND count(DISTINCT serial) FILTER (counts) = 1
                    THEN any_value(serial) FILTER (counts) END AS serial,
               max(recorded_at) FILTER (counts) AS recorded_at,
               CASE WHEN count(DISTINCT trajectory) FILTER (role = 'held_out') = 1
                    THEN any_value(trajectory) FILTER (role = 'held_out') END AS motion
        FROM (
            SELECT id, role, r.robot, r.serial, r.recorded_at, r.trajectory,
                   role = 'fit' OR NOT bool_or(role = 'fit') OVER (PARTITION BY id)
                       AS counts
            FROM ({parts}) JOIN catalogue.runs r ON run_id = parent
        )
        GROUP BY id
        UNION ALL
        SELECT run_id, robot, serial, recorded_at, trajectory FROM catalogue.runs
    """


def quote_sql_text(value: str) -> str:
    """Return a text as SQL writes it."""
    return "'" + value.replace("'", "''") + "'"


def _listed(columns: Iterable[ViewColumn]) -> str:
    return ", ".join(f'"{column.name}"' for column in columns)


def _unnested(view: str, kind: str, key: str) -> str:
    key_column, *columns_of_row = VIEWS[view]
    columns = ", ".join(f'item."{c.name}" AS "{c.name}"' for c in columns_of_row)
    query = (
        f"SELECT {key} AS {key_column.name}, {columns} "
        f"FROM (SELECT {key}, unnest({view}) AS item FROM catalogue.{kind})"
    )
    if (view, kind) == ("errors", "diagnoses"):
        # Of one held-out run a diagnosis has figures both of the run and of all runs.
        return f"SELECT * EXCLUDE (value), min(value) AS value FROM ({query}) GROUP BY ALL"
    return query


def _verdicts() -> str:
    """A row per finding and run; one without a finding for a verdict that has none."""
    return """
        SELECT d.diagnosis_id, d.created, d.robot, r.serial, d.verdict,
               e."order", e.name AS effect, e.joints, e.parameter, e.value, e.std,
               e.unit, e.probability, r.run_id, l.role, r.trajectory, r.recorded_at,
               r.tags
        FROM catalogue.diagnoses d
        LEFT JOIN (
            SELECT diagnosis_id, item.* FROM (
                SELECT diagnosis_id, unnest(effects) AS item FROM catalogue.diagnoses
            )
        ) e USING (diagnosis_id)
        LEFT JOIN (
            SELECT diagnosis_id, item.parent, item.role FROM (
                SELECT diagnosis_id, unnest(lineage) AS item FROM catalogue.diagnoses
            ) WHERE item.role IN ('fit', 'held_out', 'baseline')
        ) l USING (diagnosis_id)
        LEFT JOIN catalogue.runs r ON r.run_id = l.parent
    """


def build_signal_table() -> pa.Table:
    """Return what the view ``channels`` knows of every signal."""
    return pa.table(
        {
            "signal": list(SIGNALS),
            "unit": [signal.unit for signal in SIGNALS.values()],
            "per_joint": [signal.per_joint for signal in SIGNALS.values()],
        }
    )
