"""modelgap wear: friction from day to day, told from warming up within the day."""

from rich.console import Console

from flows.cli.options import STDOUT, named_files
from flows.outputs import check_writable, json_text, progress_bar, say, write_all
from flows.report.console import show
from flows.report.monitoring import WEAR_KEY, wear_sentence, wear_table
from flows.settings import store_folder
from flows.steps.loop.wear import Wear, follow


def wear(
    *runs: str,
    robot: str,
    model: str | None = None,
    json: str | None = None,
    store: str | None = None,
) -> None:
    """Tell wear from warming up in the stored runs of a robot.

    ```
    modelgap wear --robot irb140
    ```

    Friction that falls within a session and is back the next morning is warmth; what
    moves from day to day at equal warmth is wear. It takes runs of several days, some
    early and some late in their session, and says so where they cannot tell.

    Args:
        runs: Runs of the store; all of the robot, the latest 200, where none is given.
        robot: Built-in name (irb140), URDF file, or folder with one *.urdf.
        model: Hold the runs against this model: nominal, or an id. Without it the
            adopted one, or one that is identified from the runs.
        json: File for the outcome as JSON; "-" prints it and nothing else.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    files = named_files({"--json": json})
    check_writable(files, ())
    with progress_bar() as progress:
        found = follow(store_folder(store), robot, runs, model, progress)
    text = json_text(document(found))
    write_all({path: text for path in files.values()})
    if json == STDOUT:
        print(text, end="")
        return
    console = Console()
    if found.line:
        say(console, found.line)
    show(console, wear_sentence(found), wear_table(found), WEAR_KEY)


def document(found: Wear) -> dict:
    """Return the outcome as plain values; changes are relative, NaN is null."""
    return {
        "schema": 1,
        "robot": found.robot,
        "clock": found.clock,
        "time_constant": found.time,
        "joints": [
            {
                "joint": one.joint,
                "logs": one.logs,
                "wear_per_30_days": _rate(one.wear),
                "cold_to_warm": _rate(one.warming),
                "why_not": one.why,
            }
            for one in found.joints
        ],
        "runs": [
            {
                "run_id": id,
                "day": float(day),
                "session": float(since),
                "change": [None if v != v else float(v) for v in change],
            }
            for id, day, since, change in zip(
                found.runs, found.days, found.sessions, found.change, strict=True
            )
        ],
    }


def _rate(rate) -> dict | None:
    if rate is None:
        return None
    keys = ("value", "low", "high", "real")
    return {key: getattr(rate, key) for key in keys}
