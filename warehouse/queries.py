"""The views over the store, and queries that have a name."""

from collections.abc import Iterable, Mapping, Sequence

from warehouse.layout import KINDS
from warehouse.schema import (
    DEFAULT_DOF,
    VIEWS,
    Column,
    arrow_schema,
    channel_names,
    sample_columns,
)

# Arrow names of types, as DuckDB has them.
_TYPES = {"string": "VARCHAR", "double": "DOUBLE", "int32": "INTEGER"}

NAMED = {
    "error_by_trajectory": (
        "held-out error [%] by motion and joint (none: all together), all diagnoses",
        """
        SELECT trajectory, joint, metric, count(DISTINCT run_id) AS runs,
               round(avg(value) FILTER (stage = 'nominal'), 2) AS nominal,
               round(avg(value) FILTER (stage = 'identified'), 2) AS identified,
               round(avg(value) FILTER (stage = 'augmented'), 2) AS augmented
        FROM errors
        WHERE run_id IS NOT NULL AND metric IN ('held_out', 'filtered', 'moving')
        GROUP BY ALL ORDER BY trajectory, metric, joint
        """,
    ),
    "before_after": (
        "error on held-out motion, all joints together, by diagnosis",
        """
        WITH proof AS (
            SELECT source_id, stage,
                   coalesce(any_value(value) FILTER (run_id IS NULL), avg(value)) AS v
            FROM errors WHERE metric = 'held_out' AND joint IS NULL GROUP BY ALL
        )
        SELECT created, diagnosis_id, verdict,
               round(any_value(v) FILTER (stage = 'nominal'), 2) AS nominal,
               round(any_value(v) FILTER (stage = 'identified'), 2) AS identified,
               round(any_value(v) FILTER (stage = 'augmented'), 2) AS augmented
        FROM proof JOIN diagnoses ON diagnosis_id = source_id
        GROUP BY ALL ORDER BY created, diagnosis_id
        """,
    ),
    "worst_joints": (
        "joints by the error that is left after the diagnosis",
        """
        SELECT robot, joint, round(avg(value), 2) AS mean, count(*) AS figures
        FROM errors JOIN diagnoses ON diagnosis_id = source_id
        WHERE stage = 'augmented' AND metric = 'held_out' AND joint IS NOT NULL
        GROUP BY ALL ORDER BY mean DESC
        """,
    ),
    "findings": (
        "effects that were named, latest diagnosis first",
        """
        SELECT created, diagnosis_id, "order", name, joints, parameter, value, std,
               unit, round(probability, 3) AS probability
        FROM effects JOIN diagnoses USING (diagnosis_id)
        ORDER BY created DESC, diagnosis_id, "order", parameter, joints
        """,
    ),
    "twin_error": (
        "torque error against the nominal twin by motion and joint",
        """
        SELECT trajectory, joint, round(avg(value), 3) AS rms_e_tau, count(*) AS runs
        FROM errors WHERE stage = 'twin' AND metric = 'rms_e_tau'
        GROUP BY ALL ORDER BY trajectory, joint
        """,
    ),
    "blind_confusion": (
        "what was hidden against what was named first, by the latest code",
        """
        SELECT drawn, coalesce(effect, 'none') AS hidden,
               coalesce(named_first, verdict) AS named, outcome, count(*) AS cases
        FROM blind JOIN validations USING (validation_id)
        WHERE method_hash = (
            SELECT arg_max(method_hash, created)
            FROM blind JOIN validations USING (validation_id)
        )
        GROUP BY ALL ORDER BY ALL
        """,
    ),
    "runs_of_models": (
        "which runs went into which model",
        """
        SELECT model_id, stage, role, run_id, trajectory, source
        FROM models JOIN lineage ON child = model_id JOIN runs ON run_id = parent
        ORDER BY models.created DESC, model_id, role, run_id
        """,
    ),
}


def catalogue_views() -> dict[str, str]:
    """Return the query behind each view that is made of catalogue rows, by name."""
    views = {name: _flat(name) for name in KINDS if name != "runs"}
    runs = ", ".join(_quoted(c) for c in VIEWS["runs"][:-1])
    views["runs"] = (
        f"SELECT {runs}, run_id IN (FROM catalogue.quarantine) AS quarantined "
        "FROM catalogue.runs"
    )
    views["channels"] = _channels()
    for view in ("effects", "errors", "lineage", "blind"):
        kinds = [kind for kind in KINDS.values() if view in kind.lists]
        parts = [_unnested(view, kind.name, kind.key) for kind in kinds]
        views[view] = " UNION ALL ".join(parts)
    return views


def samples_view(groups: Mapping[tuple[tuple[str, ...], int], Sequence[str]]) -> str:
    """Return the query behind ``samples``.

    Runs with the same channels are read together: then one footer says what all of
    them hold, and nobody has to open thousands before the first query.

    Args:
        groups: Files by the signals and the number of joints that they hold.
    """
    most = max((dof for _, dof in groups), default=DEFAULT_DOF)
    columns = sample_columns(max(most, DEFAULT_DOF))
    parts = [_part(columns, *held, files) for held, files in groups.items()]
    return " UNION ALL ".join(parts) or _nothing(columns)


def _part(
    columns: Sequence[Column], signals: Sequence[str], dof: int, files: Iterable[str]
) -> str:
    held = {"robot", "run_id"}
    held.update(name for signal in signals for name in channel_names(signal, dof))
    wanted = [
        c.name if c.name in held else f"CAST(NULL AS DOUBLE) AS {c.name}"
        for c in columns
    ]
    listed = ", ".join(text(file) for file in files)
    return (
        f"SELECT {', '.join(wanted)} FROM read_parquet([{listed}], "
        "hive_partitioning = true, hive_types = {robot: VARCHAR, run_id: VARCHAR})"
    )


def text(value: str) -> str:
    """Return a text as SQL writes it."""
    return "'" + value.replace("'", "''") + "'"


def _nothing(columns: Sequence[Column]) -> str:
    typed = (
        f"CAST(NULL AS {_TYPES[str(f.type)]}) AS {f.name}"
        for f in arrow_schema(tuple(columns))
    )
    return f"SELECT {', '.join(typed)} WHERE false"


def _flat(kind: str) -> str:
    columns = ", ".join(_quoted(c) for c in VIEWS[kind])
    return f"SELECT {columns} FROM catalogue.{kind}"


def _unnested(view: str, kind: str, key: str) -> str:
    own, *rest = VIEWS[view]
    columns = ", ".join(f"item.{_quoted(c)} AS {_quoted(c)}" for c in rest)
    return (
        f"SELECT {key} AS {own.name}, {columns} "
        f"FROM (SELECT {key}, unnest({view}) AS item FROM catalogue.{kind})"
    )


def _channels() -> str:
    return """
        SELECT run_id, concat(signal, joint) AS channel, unit, joint
        FROM (
            SELECT run_id, signal, unit,
                   unnest(CASE WHEN per_joint THEN range(1, dof + 1) ELSE [NULL] END)
                       ::INTEGER AS joint
            FROM (SELECT run_id, dof, unnest(signals) AS signal FROM catalogue.runs)
            JOIN catalogue.signals USING (signal)
        )
    """


def _quoted(column: Column) -> str:
    return f'"{column.name}"'
