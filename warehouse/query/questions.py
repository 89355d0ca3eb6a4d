"""More queries that have a name: what an engineer asks of months of runs."""

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

QUESTIONS = {
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

TAKES = {"first_run_with": {"effect": "name of the effect, such as payload"}}
