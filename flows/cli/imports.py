"""modelgap import: measured logs become runs of the store."""

from rich.console import Console

from flows.cli.options import Flag, Log, Tags
from flows.outputs import say
from flows.report.console import show
from flows.report.records import channels, log_lines
from flows.requests import Import
from flows.settings import store_folder
from flows.steps import imports as steps
from warehouse.objects.mirror import shown


def import_(
    *logs: Log,
    robot: str,
    map: str | None = None,
    trajectory: str | None = None,
    kind: str = "log",
    dry_run: Flag = False,
    store: str | None = None,
    trust_log: Flag = False,
    serial: str | None = None,
    tag: Tags = (),
    recorded_at: str | None = None,
) -> None:
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
        robot: Built-in name (irb140), URDF file, or folder with one *.urdf and an
            optional robot.toml.
        map: TOML file that says which column is what, in which unit; for bags which
            topic, and which joint has which name.
        trajectory: A word for the kind of motion, by which queries can group.
        kind: A word for what it was recorded for.
        dry_run: Only show what was understood, and the id it would have.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        trust_log: Go on although a fault of the logs is certain (modelgap check).
        serial: Serial number of the arm, as in its robot.toml: what is known of one arm
            is then kept apart from others of its kind.
        tag: A word, or KEY=VALUE, such as cell=4; may be given several times.
        recorded_at: When the first sample was taken, as 2026-11-20T14:03:00+01:00;
            without it what the log says: the clock of a bag or MCAP, a line above the
            table, recorded_at in the metadata of Parquet, a column of time since 1970.
    """
    place, console = store_folder(store), Console()
    about = {"serial": serial, "tags": tag, "recorded_at": recorded_at}
    request = Import(logs, robot, map, trajectory, kind, place, trust_log, **about)
    arm, read = steps.read_logs(request)
    for log in read:
        if dry_run:
            show(console, channels(log))
        say(console, *log_lines(log, arm, dry_run))
    sound, report = steps.check_logs(request, arm, read)
    say(console, *(f"warning: {sentence}" for sentence in report.sentences))
    for log in () if dry_run else sound:
        id = steps.store_log(log, request, arm)
        word = "was in" if log.stored else "stored in"
        say(console, f"{id}  {log.known.id}: {word} {shown(place)}")
        if log.stored and (tag or recorded_at):
            say(console, "  its tags and time stay as they were stored")
