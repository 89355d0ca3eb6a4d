"""modelgap check: whether logs are what they say they are."""

from flows.cli.options import STDOUT, Log, console_beside, named_files, parse_declared
from flows.outputs import check_writable, json_text, read_files, say, write_all
from flows.report.words.verdict import check_lines
from flows.requests import Check
from flows.steps import check as steps


def check(
    *logs: Log,
    robot: str,
    declared: str | None = None,
    map: str | None = None,
    json: str | None = None,
    store: str | None = None,
) -> None:
    """Check logs before any modelling: units, signs, order of joints, clock, sensors.

    Every fault is told with its evidence, how certain it is, and the line for the map
    or the robot file that mends it. What is certain makes diagnose, identify, calibrate
    and import stop; here it does not: the exit code is 0 whatever is found.

    ```
    modelgap check A.csv B.csv --robot arm.urdf
    modelgap check A.csv --robot arm.urdf --map COLUMNS.toml --json check.json
    ```

    Args:
        logs: Logs: CSV, Parquet, ROS bag or MCAP, a window as in FILE@0:16.5 or
            FILE@60%:, or the id of a run of the store.
        robot: Built-in name (irb140), URDF file, or folder with one *.urdf and an
            optional robot.toml.
        declared: Effects that the model has, as a,b; "none" for a bare rigid body.
            Without it the robot's own list, or viscous,coulomb,rotor_inertia.
        map: TOML file that says which column is what, in which unit.
        json: File for the faults as JSON; "-" prints it and nothing else.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    names = parse_declared(declared)
    request = Check(logs, robot, names, columns=map, store=store)
    files = named_files({"--json": json})
    check_writable(files, read_files((*logs, robot), map))
    console = console_beside(json)
    read = steps.read_logs(request)
    say(console, *read.lines[1:])
    report = steps.check(read, names)
    text = json_text(report.to_json())
    write_all({path: text for path in files.values()})
    say(console, *check_lines(report))
    say(console, *(f"wrote {path}" for path in files.values()))
    if json == STDOUT:
        print(text, end="")
