"""modelgap check, map and import: logs before any modelling."""

from dataclasses import replace
from pathlib import Path

from rich.console import Console

from flows.cli.app import Outputs
from flows.outputs import read_files, say
from flows.report.console import show
from flows.report.records import channels, log_lines
from flows.report.words.verdict import check_lines
from flows.requests import Check, File, Flag, Import, Json, Log, Map
from flows.settings import store_folder
from flows.steps import check as checking
from flows.steps import imports
from residual.errors import InputError
from warehouse.remote import shown


def check(*logs: Log, request: Check, json: Json = None) -> None:
    """Check logs before any modelling: units, signs, order of joints, clock, sensors.

    Every fault is told with its evidence, how certain it is, and the line for the map
    or the robot file that fixes it. What is certain makes diagnose, identify, calibrate
    and import stop; here it does not: the exit code is 0 whatever is found.

    ```
    modelgap check A.csv B.csv --robot arm.urdf
    modelgap check A.csv --robot arm.urdf --map COLUMNS.toml --json check.json
    ```

    Args:
        logs: Logs: CSV, Parquet, ROS bag or MCAP, a window as in FILE@0:16.5 or
            FILE@60%:, or the id of a run of the store.
    """
    request = replace(request, logs=logs)
    out = Outputs({"--json": json}, read_files((*logs, request.robot), request.columns))
    read = checking.read_logs(request)
    out.say(*read.lines[1:])
    report = checking.check(read)
    out.write(document=report.to_json)
    out.say(*check_lines(report))
    out.finish()


def map_(log: Log, *, request: Map, out: File = None) -> None:
    """Draft the map of a log: which column is what, in which unit.

    From the names, the units that the file states, the joints of the URDF and the
    numbers. Nothing is applied: read the draft, then give it with --map, or put its
    lines under [columns] in robot.toml. What is not certain is a comment with "?".

    ```
    modelgap map log.csv --robot arm.urdf --out COLUMNS.toml
    modelgap diagnose log.csv --robot arm.urdf --map COLUMNS.toml
    ```

    Known by their names: Universal Robots (RTDE), Franka (libfranka), KUKA (FRI), ROS
    joint states; the rest by the words in them.

    Args:
        log: Log: CSV, Parquet, ROS bag or MCAP.
        out: File for the map; without it the map is printed.
    """
    files = read_files((log, request.robot))
    outputs = Outputs({"--out": out}, files)
    text = checking.draft_map(replace(request, log=log))
    if out is None:
        print(text, end="")
        return
    if Path(out).exists() and Path(out).read_bytes() != text.encode():
        # A draft is there to be edited: what somebody set right is not lost.
        raise InputError(
            f"--out {out}: there is a file of other lines, and they may be yours. "
            "Name another one, or delete it."
        )
    unsure = [line[4:] for line in text.splitlines() if line.startswith("# ?")]
    outputs.say(*(f"not certain: {line}" for line in unsure))
    outputs.write({"--out": lambda: text})
    outputs.finish()


def import_(*logs: Log, request: Import, dry_run: Flag = False) -> None:
    """Put measured logs into the store, as runs like any other.

    Then their ids stand for them: in identify, calibrate, diagnose, monitor and SQL.

    ```
    modelgap import monday.csv --robot arm.urdf --dry-run
    modelgap import monday.csv tuesday.mcap --robot arm.urdf --map COLUMNS.toml
    modelgap import weld.bag@2:40 --robot arm_folder --trajectory welding
    ```

    CSV with any separator, also with lines above the names as RobotStudio's viewers
    write them, Parquet, ROS 1 and ROS 2 bags, MCAP. Of bags the joint states are read,
    joints by their names in the URDF. --dry-run shows what was understood and stores
    nothing. A log that is in the store already is not stored again.

    Args:
        logs: Logs; FILE@0:16.5 takes a window in seconds from the first sample.
        dry_run: Only show what was understood, and the id it would have.
    """
    place, console = store_folder(request.store), Console()
    request = replace(request, logs=logs, store=place)
    arm, read = imports.read_logs(request)
    say(console, *(f"{arm.name}: {note}" for note in arm.notes))
    for log in read:
        if dry_run:
            show(console, channels(log))
        say(console, *log_lines(log, arm, dry_run))
    sound, report = imports.check_logs(request, arm, read)
    say(console, *(f"warning: {sentence}" for sentence in report.sentences))
    for log in () if dry_run else sound:
        id = imports.store_log(log, request, arm)
        word = "was in" if log.stored else "stored in"
        say(console, f"{id}  {log.known.id}: {word} {shown(place)}")
        if log.stored and (request.tags or request.recorded_at):
            say(console, "  its tags and time stay as they were stored")
