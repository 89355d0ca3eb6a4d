"""What the pages ask of a store, in SQL over its views."""

# Every diagnosis with its number among those of its robot, its errors over all joints
# (the model that the robot had, and with what was found), and its report.
DIAGNOSES = """
    WITH each AS (
        SELECT source_id, stage,
               coalesce(any_value(value) FILTER (run_id IS NULL), avg(value)) AS v
        FROM errors WHERE metric = 'filtered' AND joint IS NULL GROUP BY ALL
    ), proof AS (
        SELECT source_id, any_value(v) FILTER (stage = 'nominal') AS before,
               any_value(v) FILTER (stage = 'augmented') AS after
        FROM each GROUP BY ALL
    ), page AS (
        SELECT parent AS diagnosis_id, arg_max(report_id, created) AS report_id
        FROM reports JOIN lineage ON child = report_id AND role = 'diagnosis'
        WHERE kind <> 'proposal' GROUP BY ALL
    ), version AS (
        SELECT diagnosis_id AS parent, min(adoption_id) AS adoption
        FROM adoptions WHERE action <> 'rolled back' GROUP BY ALL
    )
    SELECT d.diagnosis_id AS id, d.robot, d.created, d.verdict, before, after,
           report_id, adoption,
           row_number() OVER (PARTITION BY d.robot ORDER BY d.created, d.diagnosis_id)
               AS number
    FROM diagnoses d
    LEFT JOIN proof ON source_id = d.diagnosis_id
    LEFT JOIN page ON page.diagnosis_id = d.diagnosis_id
    LEFT JOIN (SELECT child, any_value(parent) AS parent FROM lineage
               WHERE role = 'nominal' GROUP BY child) AS had
        ON had.child = d.diagnosis_id
    LEFT JOIN version ON version.parent = had.parent
    ORDER BY d.created DESC, d.diagnosis_id DESC
"""

NUMBER = """
    SELECT count(*) AS number FROM diagnoses d
    JOIN diagnoses own ON own.robot = d.robot
    WHERE own.diagnosis_id = $id
      AND (d.created, d.diagnosis_id) <= (own.created, own.diagnosis_id)
"""

EFFECTS = """
    SELECT DISTINCT diagnosis_id AS id, name, joints
    FROM effects JOIN diagnoses USING (diagnosis_id) WHERE robot = $robot
"""

# A proposal is answered where its robot has got another model since.
PROPOSALS = """
    SELECT report_id, r.robot, r.created, parent AS id,
           NOT EXISTS (SELECT 1 FROM adoptions a
                       WHERE a.robot = r.robot AND a.created > r.created) AS waits
    FROM reports r JOIN lineage ON child = report_id AND role = 'diagnosis'
    WHERE kind = 'proposal' ORDER BY r.created DESC, report_id
"""

WATCHED = """
    SELECT v.validation_id AS id, v.robot, v.created, count(a.run_id) AS alarms,
           count(DISTINCT a.run_id) AS runs,
           list(DISTINCT concat('joint ', a.joint, ': ', a.sensor, ' ', a.fault))
               FILTER (a.run_id IS NOT NULL) AS what
    FROM validations v LEFT JOIN alarms a ON a.validation_id = v.validation_id
    WHERE v.kind = 'monitor' GROUP BY ALL ORDER BY v.created DESC, id
"""

ADOPTIONS = """
    SELECT adoption_id AS id, robot, serial, action, diagnosis_id, who, note, before,
           after, created
    FROM adoptions ORDER BY adoption_id DESC
"""

STUDIES = """
    SELECT report_id AS id, robot, created FROM reports WHERE kind = 'blind'
    ORDER BY created DESC, report_id
"""

MODELS = """
    SELECT model_id AS id, robot, stage, created FROM models
    WHERE stage <> 'augmented' OR model_id IN (SELECT model_id FROM adoptions)
    ORDER BY created DESC, model_id
"""

RUNS = """
    SELECT run_id AS id, robot, source, trajectory, duration_s, seed, created,
           quarantined
    FROM runs ORDER BY created DESC, run_id
"""

# Individual values: sigma is the mean moving range over 1.128 (Shewhart), of the first
# ten; nothing is said of fewer than five.
PARAMETERS = """
    WITH nights AS (
        SELECT joint, name, unit, created, model_id, value,
               row_number() OVER one AS night,
               abs(value - lag(value) OVER one) AS moved
        FROM parameters JOIN models USING (model_id)
        WHERE status = 'fitted' AND robot = $robot
        WINDOW one AS (PARTITION BY joint, name ORDER BY created, model_id)
    ), usual AS (
        SELECT joint, name, count(*) AS n, avg(value) AS centre,
               avg(moved) / 1.128 AS sigma
        FROM nights WHERE night <= 10 GROUP BY ALL
    )
    SELECT joint, name, unit, created, value, centre,
           CASE WHEN n >= 5 THEN 3 * sigma END AS width
    FROM nights JOIN usual USING (joint, name)
    ORDER BY joint, name, created, model_id
"""
