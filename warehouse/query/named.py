"""Queries that have a name: what people ask most, in SQL over the views."""

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

# What each answers, and how. $words stand for values that the asker gives.
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
              AND source_id IN (SELECT diagnosis_id FROM diagnoses)
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
    "runs_of_models": (
        "which runs went into which model",
        """
        SELECT model_id, stage, role, run_id, trajectory, source
        FROM models JOIN lineage ON child = model_id JOIN runs ON run_id = parent
        ORDER BY models.created DESC, model_id, role, run_id
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
        "parameters that were identified, latest model first",
        """
        SELECT created, model_id, robot, joint, name, value, std, nominal, unit, status
        FROM parameters JOIN models USING (model_id)
        ORDER BY created DESC, model_id, joint, name
        """,
    ),
    "identified_error": (
        "error before and after identification [%], all joints together",
        """
        SELECT created, model_id, robot, metric,
               round(any_value(value) FILTER (errors.stage = 'nominal'), 2) AS nominal,
               round(any_value(value) FILTER (errors.stage = 'identified'), 2)
                   AS identified
        FROM errors JOIN models ON model_id = source_id
        WHERE joint IS NULL GROUP BY ALL ORDER BY created, model_id, metric
        """,
    ),
    "parameter_drift": (
        "one parameter over time, and by how many standard deviations it moved",
        """
        WITH found AS (
            SELECT created, model_id AS source_id, robot, joint, name, value, std, unit
            FROM parameters JOIN models USING (model_id)
            UNION ALL
            SELECT created, diagnosis_id, robot, joints[1],
                   concat(name, ' ', parameter), value, std, unit
            FROM effects JOIN diagnoses USING (diagnosis_id)
        )
        SELECT created, source_id, robot, joint, name, value, std, unit,
               value - first(value) OVER one AS moved,
               abs(value - first(value) OVER one)
                   / nullif(sqrt(std ** 2 + first(std) OVER one ** 2), 0) AS deviations
        FROM found WHERE name ILIKE concat('%', $name, '%') AND value IS NOT NULL
        WINDOW one AS (PARTITION BY robot, joint, name ORDER BY created, source_id)
        ORDER BY robot, joint, name, created, source_id
        """,
    ),
    "error_by_model": (
        "held-out error [%] of the model that the robot had, diagnosis by diagnosis",
        f"""
        {VERSIONS}
        SELECT created, robot, coalesce(adoption, 'nominal') AS version, diagnosis_id,
               verdict, round(any_value(v) FILTER (stage = 'nominal'), 2) AS before,
               round(any_value(v) FILTER (stage = 'augmented'), 2) AS with_findings
        {BY_VERSION}
        GROUP BY ALL ORDER BY robot, created, diagnosis_id
        """,
    ),
    "control_limits": (
        "identified parameters, night by night, and which are beyond three sigma",
        """
        WITH nights AS (
            SELECT robot, joint, name, created, model_id, value, unit,
                   row_number() OVER one AS night,
                   abs(value - lag(value) OVER one) AS moved
            FROM parameters JOIN models USING (model_id) WHERE status = 'fitted'
            WINDOW one AS (PARTITION BY robot, joint, name ORDER BY created, model_id)
        ), usual AS (
            -- Of individual values sigma is the mean moving range over 1.128.
            SELECT robot, joint, name, count(*) AS n, avg(value) AS centre,
                   avg(moved) / 1.128 AS sigma
            FROM nights WHERE night <= 10 GROUP BY ALL
        )
        SELECT robot, joint, name, night, created, model_id, value, unit, centre,
               centre - 3 * sigma AS lower, centre + 3 * sigma AS upper,
               night > n AND abs(value - centre) > 3 * sigma AS beyond
        FROM nights JOIN usual USING (robot, joint, name)
        WHERE n >= 5 ORDER BY beyond DESC, robot, joint, name, night
        """,
    ),
    "calibration_errors": (
        "error of validation of the correction tables [%], by scheme and form",
        """
        SELECT created, validation_id, substr(metric, 7) AS scheme, stage AS form,
               round(value, 2) AS rmsev
        FROM errors JOIN validations ON validation_id = source_id
        WHERE kind = 'calibration' AND joint IS NULL AND run_id IS NULL
              AND starts_with(metric, 'rmsev_')
        ORDER BY created, validation_id, scheme, rmsev
        """,
    ),
    "monitoring_alarms": (
        "alarms of the sensors, latest monitoring first",
        """
        SELECT created, validation_id, robot, run_id, round(time, 3) AS time, joint,
               sensor, fault, round(score, 2) AS score, round(until, 3) AS until
        FROM alarms JOIN validations USING (validation_id)
        ORDER BY created DESC, validation_id, run_id, time
        """,
    ),
    "error_by_week": (
        "held-out error [%] by robot, joint and week, before and after the diagnosis",
        """
        SELECT robot, date_trunc('week', created)::DATE AS week, joint,
               count(DISTINCT source_id) AS diagnoses,
               round(avg(value) FILTER (stage = 'nominal'), 2) AS nominal,
               round(avg(value) FILTER (stage = 'augmented'), 2) AS augmented
        FROM errors JOIN diagnoses ON diagnosis_id = source_id
        WHERE metric = 'held_out' AND joint IS NOT NULL
        GROUP BY ALL ORDER BY robot, joint, week
        """,
    ),
    "findings_by_week": (
        "how often each effect was named, by robot and week",
        """
        SELECT robot, date_trunc('week', created)::DATE AS week, effect, joints,
               count(DISTINCT diagnosis_id) AS diagnoses,
               round(max(probability), 3) AS surest
        FROM verdicts WHERE effect IS NOT NULL
        GROUP BY ALL ORDER BY robot, week, diagnoses DESC, effect, joints
        """,
    ),
    "first_run_with": (
        "the first run in whose diagnosis an effect was named, by robot and joint",
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
    "before_after_by_version": (
        "held-out error [%] before and with the findings, by version of the model",
        f"""
        {VERSIONS}
        SELECT robot, coalesce(adoption, 'nominal') AS version,
               count(DISTINCT diagnosis_id) AS diagnoses,
               round(avg(v) FILTER (stage = 'nominal'), 2) AS before,
               round(avg(v) FILTER (stage = 'augmented'), 2) AS with_findings
        {BY_VERSION}
        GROUP BY ALL ORDER BY robot, version
        """,
    ),
    "latest_verdicts": (
        "what the latest diagnosis of each robot says, a row per finding",
        """
        WITH latest AS (
            SELECT robot, arg_max(diagnosis_id, created) AS diagnosis_id
            FROM diagnoses GROUP BY ALL
        )
        SELECT DISTINCT v.robot, v.created, diagnosis_id, verdict, "order", effect,
               joints, parameter, value, std, unit, round(probability, 3) AS probability
        FROM verdicts v JOIN latest USING (diagnosis_id)
        ORDER BY v.robot, "order", parameter, joints
        """,
    ),
    "open_verdicts": (
        "verdicts unknown or unsure (under 95 %), and no sure one of that robot since",
        """
        WITH judged AS (
            SELECT *, verdict = 'unknown' OR coalesce(least < 0.95, false) AS unsure
            FROM (
                SELECT robot, diagnosis_id, created, verdict,
                       min(probability) AS least
                FROM verdicts GROUP BY ALL
            )
        )
        SELECT robot, created, diagnosis_id, verdict, round(least, 3) AS least_sure
        FROM judged one
        WHERE unsure AND NOT EXISTS (
            FROM judged later WHERE later.robot = one.robot
            AND later.created > one.created AND NOT later.unsure
        )
        ORDER BY robot, created
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
    "runs_by_tag": (
        "runs by the tags that they were given",
        """
        SELECT tag, robot, count(*) AS runs,
               min(coalesce(recorded_at, created)) AS first,
               max(coalesce(recorded_at, created)) AS last
        FROM (SELECT *, unnest(tags) AS tag FROM runs)
        GROUP BY ALL ORDER BY tag, robot
        """,
    ),
    "runs_by_code": (
        "which code on which machine made how many runs",
        """
        SELECT version, "commit", dirty, machine, count(*) AS runs,
               min(created) AS first, max(created) AS last
        FROM runs GROUP BY ALL ORDER BY last DESC, "commit"
        """,
    ),
    "campaigns": (
        "campaigns: how many runs, how much motion, how many in quarantine",
        """
        SELECT campaign, robot, count(*) AS runs, round(sum(duration_s), 1) AS seconds,
               count(*) FILTER (quarantined) AS quarantined,
               min(created) AS first, max(created) AS last
        FROM runs WHERE campaign IS NOT NULL
        GROUP BY ALL ORDER BY last DESC, campaign
        """,
    ),
    "alarms_by_joint": (
        "alarms by robot, joint and what was wrong, with the first and the last run",
        """
        SELECT v.robot, joint, sensor, fault, count(*) AS alarms,
               arg_min(a.run_id, v.created) AS first_run,
               arg_max(a.run_id, v.created) AS last_run, max(v.created) AS last
        FROM alarms a JOIN validations v USING (validation_id)
        GROUP BY ALL ORDER BY alarms DESC, robot, joint, fault
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
}

# Values that a query needs, by query.
TAKES: dict[str, dict[str, str]] = {
    "runs_of_model": {"model": "id of the model, or its beginning"},
    "made_from_run": {"run": "id of the run, or its beginning"},
    "parameter_drift": {"name": "part of the parameter's name"},
    "first_run_with": {"effect": "name of the effect, such as payload"},
}
