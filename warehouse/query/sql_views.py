"""The SQL of the views over the catalogue, and named queries of frequent questions."""

from collections.abc import Iterable

import pyarrow as pa

from warehouse.view_schema import (
    COMPUTED,
    KINDS,
    SIGNALS,
    VIEWS,
    RecordKind,
    ViewColumn,
)

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
_ONCE = "SELECT * EXCLUDE (value), min(value) AS value FROM ({}) GROUP BY ALL"


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
    # Of one held-out run a diagnosis has figures both of the run and of all runs.
    once = _unnested("errors", "diagnoses", "diagnosis_id")
    views["errors"] = f"""
        SELECT e.* REPLACE (coalesce(e.trajectory, r.trajectory, motion) AS trajectory),
               {_UNIT} AS unit, coalesce(r.robot, a.robot) AS robot,
               coalesce(r.serial, a.serial) AS serial,
               coalesce(r.recorded_at, a.recorded_at) AS recorded_at
        FROM ({views["errors"].replace(once, _ONCE.format(once))}) e
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
        f"SELECT {kind.key} AS id, unnest(lineage, recursive := true) "
        f"FROM catalogue.{kind.name}"
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
    return (
        f"SELECT {key} AS {key_column.name}, {columns} "
        f"FROM (SELECT {key}, unnest({view}) AS item FROM catalogue.{kind})"
    )


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


# Of what is of one arm: when it was recorded, else when it was committed.
AT = "coalesce(recorded_at, created) AS recorded"

# Which diagnosis was adopted first as which version; the errors of each, by stage.
VERSIONS = """
WITH version AS (
    SELECT diagnosis_id AS parent, min(adoption_id) AS adoption
    FROM adoptions WHERE action <> 'rolled back' GROUP BY ALL
), proof AS (
    SELECT source_id, stage,
           coalesce(any_value(value) FILTER (run_id IS NULL), avg(value)) AS v
    FROM errors WHERE metric = 'filtered' AND joint IS NULL GROUP BY ALL
)
"""
# A diagnosis beside its errors and the version that it was made against.
BY_VERSION = """
FROM diagnoses JOIN proof ON source_id = diagnosis_id
LEFT JOIN lineage ON child = diagnosis_id AND role = 'nominal'
LEFT JOIN version USING (parent)
"""

# What each answers, and how. $words stand for values that the asker gives. An arm is a
# robot with its serial number; trends go by the time of recording.
NAMED = {
    "error_by_trajectory": (
        "held-out error [%] of diagnoses and identifications by arm, motion and joint",
        """
        WITH proof AS (
            SELECT errors.*, source FROM errors JOIN (
                SELECT diagnosis_id AS source_id, 'diagnosis' AS source FROM diagnoses
                UNION ALL SELECT model_id, 'identification' FROM models
            ) USING (source_id)
            -- Those of single runs, where a record has them.
            QUALIFY run_id IS NOT NULL OR NOT bool_or(run_id IS NOT NULL)
                OVER (PARTITION BY source_id, metric)
        )
        SELECT robot, serial, trajectory, joint, metric, source,
               count(DISTINCT coalesce(run_id, source_id)) AS figures,
               round(avg(value) FILTER (stage = 'nominal'), 2) AS nominal,
               round(avg(value) FILTER (stage = 'identified'), 2) AS identified,
               round(avg(value) FILTER (stage = 'augmented'), 2) AS augmented
        FROM proof
        WHERE trajectory IS NOT NULL AND metric IN ('held_out', 'filtered', 'moving')
        GROUP BY ALL ORDER BY robot, serial, trajectory, metric, joint, source
        """,
    ),
    "before_after": (
        "error on held-out motion, all joints together, by arm and diagnosis",
        f"""
        WITH proof AS (
            SELECT source_id, stage,
                   coalesce(any_value(value) FILTER (run_id IS NULL), avg(value)) AS v
            FROM errors WHERE metric = 'held_out' AND joint IS NULL GROUP BY ALL
        )
        SELECT robot, serial, {AT}, diagnosis_id, verdict,
               round(any_value(v) FILTER (stage = 'nominal'), 2) AS nominal,
               round(any_value(v) FILTER (stage = 'identified'), 2) AS identified,
               round(any_value(v) FILTER (stage = 'augmented'), 2) AS augmented
        FROM proof JOIN diagnoses ON diagnosis_id = source_id
        GROUP BY ALL ORDER BY robot, serial, recorded, diagnosis_id
        """,
    ),
    "findings": (
        "effects that were named, by arm, latest recording first",
        f"""
        SELECT robot, serial, {AT}, diagnosis_id, "order", name, joints, parameter,
               value, std, unit, round(probability, 3) AS probability
        FROM effects JOIN diagnoses USING (diagnosis_id)
        ORDER BY robot, serial, recorded DESC, diagnosis_id, "order", parameter, joints
        """,
    ),
    "twin_error": (
        "torque error against the nominal twin by arm, motion and joint",
        """
        SELECT robot, serial, trajectory, joint, round(avg(value), 3) AS rms_e_tau,
               count(*) AS runs
        FROM errors WHERE stage = 'twin' AND metric = 'rms_e_tau'
        GROUP BY ALL ORDER BY robot, serial, trajectory, joint
        """,
    ),
    "reruns_not_reproduced": (
        "reruns that gave other values: of which record, where, and why",
        """
        SELECT v.created, old.parent AS record, new.parent AS rerun, robot, verdict,
               validation_id
        FROM validations v
        LEFT JOIN lineage old ON old.child = validation_id AND old.role = 'rerun of'
        LEFT JOIN lineage new ON new.child = validation_id AND new.role = 'rerun'
        WHERE kind = 'rerun' ORDER BY v.created DESC, validation_id
        """,
    ),
    "runs_of_model": (
        "which runs went into one model",
        """
        SELECT model_id, stage, role, run_id, trajectory, source, runs.created
        FROM models JOIN lineage ON child = model_id JOIN runs ON run_id = parent
        WHERE starts_with(model_id, $model)
        ORDER BY model_id, role, runs.created, run_id
        """,
    ),
    "made_from_run": (
        "everything that was made from one run, directly or through others",
        """
        WITH RECURSIVE below(id, role, steps) AS (
            SELECT child, role, 1 FROM lineage WHERE starts_with(parent, $run)
            UNION
            SELECT child, lineage.role, steps + 1 FROM lineage JOIN below ON parent = id
            WHERE steps < 50
        )
        SELECT id, role, min(steps) AS steps FROM below GROUP BY ALL ORDER BY ALL
        """,
    ),
    "identified_parameters": (
        "parameters that were identified, by arm, latest recording first",
        f"""
        SELECT robot, serial, {AT}, model_id, joint, name, value, std, nominal, unit,
               status
        FROM parameters JOIN models USING (model_id)
        ORDER BY robot, serial, recorded DESC, model_id, joint, name
        """,
    ),
    "parameter_drift": (
        "one parameter of each arm over time, and by how many deviations it moved",
        f"""
        WITH found AS (
            SELECT {AT}, model_id AS source_id, robot, serial, joint, name, value, std,
                   unit
            FROM parameters JOIN models USING (model_id)
            UNION ALL
            SELECT {AT}, diagnosis_id, robot, serial, joints[1],
                   concat(name, ' ', parameter), value, std, unit
            FROM effects JOIN diagnoses USING (diagnosis_id)
        )
        SELECT recorded, source_id, robot, serial, joint, name, value, std, unit,
               value - first(value) OVER one AS moved,
               abs(value - first(value) OVER one)
                   / nullif(sqrt(std ** 2 + first(std) OVER one ** 2), 0) AS deviations
        FROM found WHERE name ILIKE concat('%', $name, '%') AND value IS NOT NULL
        WINDOW one AS (
            PARTITION BY robot, serial, joint, name ORDER BY recorded, source_id
        )
        ORDER BY robot, serial, joint, name, recorded, source_id
        """,
    ),
    "error_by_model": (
        "held-out error [%] of the model that the arm had, diagnosis by diagnosis",
        f"""
        {VERSIONS}
        SELECT {AT}, robot, serial, coalesce(adoption, 'nominal') AS version,
               diagnosis_id, verdict,
               round(any_value(v) FILTER (stage = 'nominal'), 2) AS before,
               round(any_value(v) FILTER (stage = 'augmented'), 2) AS with_findings
        {BY_VERSION}
        GROUP BY ALL ORDER BY robot, serial, recorded, diagnosis_id
        """,
    ),
    "control_limits": (
        "identified parameters of each arm by night, and which are beyond three sigma",
        f"""
        WITH nights AS (
            SELECT robot, serial, joint, name, {AT}, model_id, value, unit,
                   row_number() OVER one AS night,
                   abs(value - lag(value) OVER one) AS moved
            FROM parameters JOIN models USING (model_id) WHERE status = 'fitted'
            WINDOW one AS (
                PARTITION BY robot, serial, joint, name
                ORDER BY coalesce(recorded_at, created), model_id
            )
        ), usual AS (
            -- Of individual values sigma is the mean moving range over 1.128.
            SELECT robot, serial, joint, name, count(*) AS n, avg(value) AS centre,
                   avg(moved) / 1.128 AS sigma
            FROM nights WHERE night <= 10 GROUP BY ALL
        )
        SELECT a.robot, a.serial, a.joint, a.name, night, recorded, model_id, value,
               unit, centre, centre - 3 * sigma AS lower, centre + 3 * sigma AS upper,
               night > n AND abs(value - centre) > 3 * sigma AS beyond
        FROM nights a JOIN usual b ON (a.robot, a.joint, a.name)
            = (b.robot, b.joint, b.name) AND a.serial IS NOT DISTINCT FROM b.serial
        WHERE n >= 5 ORDER BY beyond DESC, a.robot, a.serial, a.joint, a.name, night
        """,
    ),
    "calibration_errors": (
        "error of validation of the correction tables [%], by arm, scheme and form",
        """
        SELECT v.robot, v.serial, coalesce(v.recorded_at, v.created) AS recorded,
               validation_id, substr(metric, 7) AS scheme, stage AS form,
               round(value, 2) AS rmsev
        FROM errors e JOIN validations v ON validation_id = source_id
        WHERE kind = 'calibration' AND joint IS NULL AND run_id IS NULL
              AND starts_with(metric, 'rmsev_')
        ORDER BY v.robot, v.serial, recorded, validation_id, scheme, rmsev
        """,
    ),
    "monitoring_alarms": (
        "alarms of the sensors, by arm, latest recording first",
        f"""
        SELECT robot, serial, {AT}, validation_id, run_id, round(time, 3) AS time,
               joint, sensor, fault, round(score, 2) AS score, round(until, 3) AS until
        FROM alarms JOIN validations USING (validation_id)
        ORDER BY robot, serial, recorded DESC, validation_id, run_id, time
        """,
    ),
    "error_by_week": (
        "held-out error [%] by arm, joint and week, before and after the diagnosis",
        """
        SELECT d.robot, d.serial,
               date_trunc('week', coalesce(d.recorded_at, d.created))::DATE AS week,
               joint, count(DISTINCT source_id) AS diagnoses,
               round(avg(value) FILTER (stage = 'nominal'), 2) AS nominal,
               round(avg(value) FILTER (stage = 'augmented'), 2) AS augmented
        FROM errors e JOIN diagnoses d ON diagnosis_id = source_id
        WHERE metric = 'held_out' AND joint IS NOT NULL
        GROUP BY ALL ORDER BY d.robot, d.serial, joint, week
        """,
    ),
    "first_run_with": (
        "the first run in whose diagnosis an effect was named, by arm and joint",
        """
        SELECT robot, serial, effect, joints,
               min(coalesce(recorded_at, created)) AS since,
               arg_min(run_id, coalesce(recorded_at, created)) AS run_id,
               arg_min(diagnosis_id, created) AS diagnosis_id,
               count(DISTINCT diagnosis_id) AS diagnoses
        FROM verdicts WHERE effect = $effect AND role = 'fit'
        GROUP BY ALL ORDER BY since, robot, joints
        """,
    ),
    "adoption_history": (
        "which models each arm had, since when, by whom and why",
        """
        SELECT robot, serial, adoption_id, action, created AS since,
               lead(created) OVER arm AS until, model_id, diagnosis_id, who, note,
               before, after
        FROM adoptions
        WINDOW arm AS (PARTITION BY robot, serial ORDER BY adoption_id)
        ORDER BY robot, serial, adoption_id
        """,
    ),
    "model_on": (
        "the model that each arm had at the end of a day, or at a time, in UTC",
        """
        SELECT robot, serial, adoption_id, action, created AS since, model_id,
               diagnosis_id, who
        FROM adoptions
        WHERE CASE WHEN length($date) <= 10
                   THEN created::DATE <= $date::DATE ELSE created <= $date::TIMESTAMP
              END
        QUALIFY row_number() OVER (
            PARTITION BY robot, serial ORDER BY adoption_id DESC
        ) = 1
        ORDER BY robot, serial
        """,
    ),
    "latest_verdicts": (
        "what the diagnosis of each arm's latest recording says, a row per finding",
        f"""
        WITH latest AS (
            SELECT robot, serial, {AT}, diagnosis_id, verdict FROM diagnoses
            QUALIFY row_number() OVER (
                PARTITION BY robot, serial
                ORDER BY coalesce(recorded_at, created) DESC, created DESC
            ) = 1
        )
        SELECT robot, serial, recorded, diagnosis_id, verdict, "order", name AS effect,
               joints, parameter, value, std, unit, round(probability, 3) AS probability
        FROM latest LEFT JOIN effects USING (diagnosis_id)
        ORDER BY robot, serial, "order", parameter, joints
        """,
    ),
    "open_verdicts": (
        "verdicts unknown or unsure (under 95 %), and no sure one of that arm since",
        f"""
        WITH judged AS (
            SELECT *, verdict = 'unknown' OR coalesce(least < 0.95, false) AS unsure
            FROM (
                SELECT robot, serial, diagnosis_id, {AT}, created, verdict,
                       min(probability) AS least
                FROM diagnoses LEFT JOIN effects USING (diagnosis_id) GROUP BY ALL
            )
        )
        SELECT robot, serial, recorded, diagnosis_id, verdict,
               round(least, 3) AS least_sure
        FROM judged one
        WHERE unsure AND NOT EXISTS (
            FROM judged later WHERE later.robot = one.robot
            AND later.serial IS NOT DISTINCT FROM one.serial
            AND (later.recorded, later.created) > (one.recorded, one.created)
            AND NOT later.unsure
        )
        ORDER BY robot, serial, recorded
        """,
    ),
    "runs_per_robot": (
        "runs and seconds of motion by robot, serial number and kind of motion",
        """
        SELECT robot, serial, trajectory, source, count(*) AS runs,
               round(sum(duration_s), 1) AS seconds,
               min(coalesce(recorded_at, created)) AS first,
               max(coalesce(recorded_at, created)) AS last
        FROM runs WHERE NOT quarantined
        GROUP BY ALL ORDER BY robot, serial, runs DESC, trajectory
        """,
    ),
    "never_diagnosed": (
        "runs that went into no diagnosis, oldest first",
        """
        SELECT run_id, robot, serial, trajectory, source,
               coalesce(recorded_at, created) AS since
        FROM runs
        WHERE NOT quarantined AND run_id NOT IN (
            SELECT parent FROM lineage JOIN diagnoses ON child = diagnosis_id
        )
        ORDER BY since, run_id
        """,
    ),
    "old_runs": (
        "folders of runs older than some days that no record needs, oldest first",
        """
        SELECT unnest([folder, concat('sealed/run_id=', run_id)][:kept]) AS folder,
               run_id, robot, serial, since
        FROM (
            SELECT *, coalesce(recorded_at, created) AS since,
                   concat('samples/robot=', robot, '/run_id=', run_id) AS folder,
                   if(source = 'simulated', 2, 1) AS kept
            FROM runs
        )
        WHERE since < make_timestamp(epoch_us(now())) - to_days(try_cast($days AS INT))
              -- That a run was looked at binds nothing.
              AND run_id NOT IN (
                  SELECT parent FROM lineage
                  WHERE role NOT IN ('batch', 'point', 'watched'))
              AND run_id NOT IN (FROM (SELECT run_id FROM alarms) WHERE run_id NOT NULL)
        ORDER BY since, run_id, folder
        """,
    ),
}

# Values that a query needs, by query.
TAKES: dict[str, dict[str, str]] = {
    "runs_of_model": {"model": "id of the model, or its beginning"},
    "made_from_run": {"run": "id of the run, or its beginning"},
    "parameter_drift": {"name": "part of the parameter's name"},
    "first_run_with": {"effect": "name of the effect, such as payload"},
    "model_on": {"date": "a day or a time, such as 2026-03-01"},
    "old_runs": {"days": "least age in days, by the recording, else by the commit"},
}
