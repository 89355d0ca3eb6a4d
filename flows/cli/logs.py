"""modelgap check, map and import."""

from dataclasses import replace
from pathlib import Path

from rich.console import Console

from flows.cli.app import Outputs
from flows.outputs import list_input_files, print_plain
from flows.requests import Check, File, Flag, Import, Json, Log, Name, RobotRequest
from flows.settings import resolve_store_folder
from residual.errors import InputError


def check(*logs: Log, request: Check, json: Json = None) -> None:
    """Check the units, signs, joint order, timing and sensors of logs.

    Without a log, the robot file: its joints, limits and bodies, and what of them is
    implausible.

    Prints each fault with its evidence, whether it is certain, and the line of the map
    or the robot file that fixes it. A certain fault stops diagnose, identify, calibrate
    and import; here the exit code is 0 in any case.

    ```
    modelgap check A.csv B.csv --robot arm.urdf
    modelgap check A.csv --robot arm.urdf --map COLUMNS.toml --json check.json
    modelgap check --robot arm.urdf
    ```

    Args:
        logs: Logs: CSV, Parquet, ROS bag or MCAP files, windows (FILE@0:16.5,
            FILE@60%:) or ids of stored runs; none to check the robot file alone.
    """
    from flows.inputs.read import read_logs
    from flows.report.document import print_parts
    from flows.report.robot_file import build_robot_document, describe_robot_check
    from flows.report.sentences import describe_check
    from flows.steps import check as checking

    request = replace(request, logs=logs)
    out = Outputs({"--json": json}, list_input_files((*logs, request.robot), request.columns))
    if not logs:
        robot, report = checking.check_robot_file(request)
        out.write(document=lambda: build_robot_document(robot, report))
        print_parts(out.console, *describe_robot_check(robot, report))
        return out.finish()
    read = read_logs(request, "to check")
    out.say(*read.lines[1:])
    report = checking.check_log_sets(read)
    out.write(document=report.to_json)
    out.say(*describe_check(report))
    return out.finish()


def map_(log: Log, /, *, request: RobotRequest, format: Name = None, out: File = None) -> None:
    """Draft the column map of a log.

    Uses the column names, the stated units, the joint names of the URDF and the
    numbers. Check the draft, then give it as --map, or copy its lines to [columns] of
    robot.toml. Comments with "?" mark guesses.

    ```
    modelgap map log.csv --robot arm.urdf --out COLUMNS.toml
    modelgap diagnose log.csv --robot arm.urdf --map COLUMNS.toml
    ```

    Knows the names of Universal Robots (RTDE), Franka (libfranka), KUKA (FRI) and ROS
    joint states.

    Args:
        log: CSV, Parquet, ROS bag or MCAP file.
        format: Format of the log, where it is not recognized: ur-rtde, franka,
            kuka-fri, robotstudio, mujoco, plotjuggler, lerobot or ros.
        out: File for the map; default: print it.
    """
    from flows.steps import check as checking

    files = list_input_files((log, request.robot))
    outputs = Outputs({"--out": out}, files)
    text = checking.draft_map(log, request.robot, format)
    if out is None:
        print(text, end="")
        return
    if Path(out).exists() and Path(out).read_bytes() != text.encode():
        raise InputError(f"--out {out} exists with other content. Name another file, or delete it.")
    unsure = [line[4:] for line in text.splitlines() if line.startswith("# ?")]
    outputs.say(*(f"not certain: {line}" for line in unsure))
    outputs.write({"--out": lambda: text})
    outputs.finish()


def import_(*logs: Log, request: Import, dry_run: Flag = False) -> None:
    """Import measured logs as runs of the store.

    Other commands and SQL then take the ids of the runs.

    ```
    modelgap import monday.csv --robot arm.urdf --dry-run
    modelgap import monday.csv tuesday.mcap --robot arm.urdf --map COLUMNS.toml
    modelgap import weld.bag@2:40 --robot arm_folder --trajectory welding
    ```

    Reads CSV with any separator, also with the header lines of RobotStudio, Parquet,
    ROS 1 and ROS 2 bags, and MCAP. Of bags it reads the joint states, by the joint
    names of the URDF. A log that is already stored is not stored again.

    Args:
        logs: Log files; FILE@0:16.5 is a window in seconds from the first sample.
        dry_run: Show the columns and the id, store nothing.
    """
    from flows.report.document import print_parts
    from flows.report.records import build_channel_table, describe_imported_log
    from flows.steps import imports
    from warehouse.remote_store import format_store_name

    place, console = resolve_store_folder(request.store), Console()
    request = replace(request, logs=logs, store=place)
    arm, read = imports.read_logs(request)
    print_plain(console, *(f"{arm.name}: {note}" for note in arm.notes))
    for log in read:
        if dry_run:
            print_parts(console, build_channel_table(log))
        print_plain(console, *describe_imported_log(log, arm, dry_run))
    sound, report = imports.check_logs(request, arm, read)
    print_plain(console, *(f"warning: {sentence}" for sentence in report.sentences))
    for log in () if dry_run else sound:
        id = imports.store_log(log, request, arm)
        word = "was in" if log.stored else "stored in"
        print_plain(console, f"{id}  {log.summary.id}: {word} {format_store_name(place)}")
        if log.stored and (request.tags or request.recorded_at):
            print_plain(console, "  its tags and time stay as they were stored")
