"""What the pages ask of a store, in SQL over its views.

A robot is its name and, where it has one, its serial number: two of a kind are two.
"""

_ROBOT = "concat_ws(' ', {0}.robot, {0}.serial)"
# Of records that have no serial number, that of the runs which they were made from.
_UNIT = """unit AS (
        SELECT child, any_value(concat_ws(' ', robot, serial)) AS robot
        FROM lineage JOIN runs ON run_id = parent GROUP BY child
    )"""

# Every diagnosis with its number among those of its robot, its errors over all joints
# (the model that the robot had, and with what was found), and its report.
DIAGNOSES = f"""
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
        WHERE kind IN ('demo', 'nightly') GROUP BY ALL
    ), version AS (
        SELECT diagnosis_id AS parent, min(adoption_id) AS adoption
        FROM adoptions WHERE action <> 'rolled back' GROUP BY ALL
    )
    SELECT d.diagnosis_id AS id,
           coalesce(nullif({_ROBOT.format("d")}, ''), '?') AS robot,
           d.created, coalesce(d.recorded_at, d.created) AS recorded, d.verdict,
           before, after, report_id, adoption::INT AS model,
           row_number() OVER (PARTITION BY d.robot, d.serial ORDER BY d.created,
                                  d.diagnosis_id)
               AS number,
           concat(robot, ' #', number) AS title
    FROM diagnoses d
    LEFT JOIN proof ON source_id = d.diagnosis_id
    LEFT JOIN page ON page.diagnosis_id = d.diagnosis_id
    LEFT JOIN (SELECT child, any_value(parent) AS parent FROM lineage
               WHERE role = 'nominal' GROUP BY child) AS had
        ON had.child = d.diagnosis_id
    LEFT JOIN version ON version.parent = had.parent
    ORDER BY d.created DESC, d.diagnosis_id DESC
"""

TITLE = f"""
    SELECT any_value({_ROBOT.format("own")}) AS robot, count(*) AS number
    FROM diagnoses d JOIN diagnoses own
        ON own.robot = d.robot AND own.serial IS NOT DISTINCT FROM d.serial
    WHERE own.diagnosis_id = $id
      AND (d.created, d.diagnosis_id) <= (own.created, own.diagnosis_id)
"""

EFFECTS = f"""
    SELECT DISTINCT diagnosis_id AS id, name, joints
    FROM effects JOIN diagnoses d USING (diagnosis_id)
    WHERE {_ROBOT.format("d")} = $robot
"""

# A proposal is answered where its robot has got another model since.
PROPOSALS = f"""
    SELECT report_id, {_ROBOT.format("d")} AS robot, r.created, parent AS id,
           NOT EXISTS (SELECT 1 FROM adoptions a
                       WHERE a.robot = d.robot AND a.created > r.created
                         AND a.serial IS NOT DISTINCT FROM d.serial) AS waits
    FROM reports r JOIN lineage ON child = report_id AND role = 'diagnosis'
    JOIN diagnoses d ON diagnosis_id = parent
    WHERE kind = 'proposal' ORDER BY r.created DESC, report_id
"""

WATCHED = f"""
    WITH {_UNIT}
    SELECT v.validation_id AS id, coalesce(unit.robot, v.robot) AS robot, v.created,
           count(a.run_id) AS alarms,
           count(DISTINCT a.run_id) AS runs,
           list(DISTINCT a.run_id) FILTER (a.run_id IS NOT NULL) AS alarmed,
           list(DISTINCT concat('joint ', a.joint, ': ',
                                CASE WHEN starts_with(a.fault, a.sensor) THEN a.fault
                                     ELSE concat(a.sensor, ' ', a.fault) END))
               FILTER (a.run_id IS NOT NULL) AS what
    FROM validations v LEFT JOIN alarms a ON a.validation_id = v.validation_id
    LEFT JOIN unit ON child = v.validation_id
    WHERE v.kind = 'monitor' GROUP BY ALL ORDER BY v.created DESC, id
"""

# The runs that a diagnosis speaks of: fitted, held out, or of the batch that it is for.
RUNS_OF = """
    SELECT parent AS id FROM lineage WHERE child = $id AND role IN ('fit', 'held_out')
    UNION
    SELECT run.parent FROM lineage run JOIN lineage named USING (child)
    WHERE named.parent = $id AND named.role = 'diagnosis' AND run.role = 'batch'
"""

# Logs that an inbox refused, with the reason (`flows.inbox.take`).
REFUSED = """
    SELECT validation_id AS id, robot, verdict AS why, created
    FROM validations WHERE kind = 'refused' ORDER BY created DESC, id
"""

ADOPTIONS = f"""
    SELECT adoption_id AS id, {_ROBOT.format("a")} AS robot, action, diagnosis_id,
           who, note, before, after, created
    FROM adoptions a ORDER BY adoption_id DESC
"""

MODELS = f"""
    WITH {_UNIT}
    SELECT model_id AS id, coalesce(unit.robot, m.robot) AS robot, stage, created
    FROM models m LEFT JOIN unit ON child = model_id
    WHERE stage <> 'augmented' OR model_id IN (SELECT model_id FROM adoptions)
    ORDER BY created DESC, model_id
"""

RUNS = f"""
    SELECT run_id AS id, {_ROBOT.format("runs")} AS robot, source, trajectory,
           duration_s, seed, created, quarantined, log, tags
    FROM runs ORDER BY created DESC, run_id
"""

# Individual values: sigma is the mean moving range over 1.128 (Shewhart), of the first
# ten; nothing is said of fewer than five.
PARAMETERS = f"""
    WITH {_UNIT}, nights AS (
        SELECT joint, name, unit, model_id, value,
               coalesce(m.recorded_at, m.created) AS recorded,
               row_number() OVER one AS night,
               abs(value - lag(value) OVER one) AS moved
        FROM parameters JOIN models m USING (model_id)
        LEFT JOIN unit ON child = model_id
        WHERE status = 'fitted' AND coalesce(unit.robot, m.robot) = $robot
        WINDOW one AS (PARTITION BY joint, name
                       ORDER BY coalesce(m.recorded_at, m.created), model_id)
    ), usual AS (
        SELECT joint, name, count(*) AS n, avg(value) AS centre,
               avg(moved) / 1.128 AS sigma
        FROM nights WHERE night <= 10 GROUP BY ALL
    )
    SELECT joint, name, unit, recorded, value, centre,
           CASE WHEN n >= 5 THEN 3 * sigma END AS width
    FROM nights JOIN usual USING (joint, name)
    ORDER BY joint, name, recorded, model_id
"""
