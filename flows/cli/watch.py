"""modelgap monitor and wear: are sensors and friction of an arm as they were?"""

from dataclasses import asdict, replace
from typing import Annotated

from cyclopts import Parameter

from flows.cli.app import STDOUT, Outputs
from flows.outputs import progress_bar
from flows.report.console import show
from flows.report.figures.scores import plot as draw
from flows.report.monitoring import (
    WEAR_KEY,
    alarm_table,
    meaning,
    wear_sentence,
    wear_table,
)
from flows.requests import Flag, Json, Monitor, Store
from flows.settings import store_folder
from flows.steps import monitor as monitoring
from flows.steps.models import chosen_to_watch
from flows.steps.monitor import Wear, follow
from residual.quantity import plain
from warehouse.mirror import shown

_HOURLY = Monitor()


def monitor(
    model: str,
    /,
    *runs: Annotated[str, Parameter(name="RUN")],
    request: Monitor = _HOURLY,
    nominal: Flag = False,
    plot: str | None = None,
) -> None:
    """Watch the sensors of runs, with limits from healthy runs.

    ```
    modelgap monitor irb140 3f2a --calibrate 01ab 02cd 03ef 04aa
    modelgap monitor 77e0 3f2a 4b1c --plot watched.png
    ```

    Encoders that freeze, jump or wander off, torque sensors with a bias, a lower gain
    or spikes: when, which joint, which sensor. In a closed loop an encoder that drifts
    slowly is hidden: the arm follows it (docs/monitoring.md).

    Args:
        model: Id of a diagnosis, or a robot (built-in name, URDF, folder) for the
            model that it has (modelgap models). Its coefficients are fitted to the
            healthy runs.
        runs: Ids of the runs to watch; the beginning is enough.
        nominal: Of a robot take the nominal model, whatever it has.
        plot: PNG file for the scores over time.
    """
    place = store_folder(request.store)
    out = Outputs({"--plot": plot})
    choice = chosen_to_watch(model, place, nominal, runs)
    out.say(*choice.lines)
    request = replace(request, model=choice.diagnosis or model, runs=runs, store=place)
    id, found, watched = monitoring.monitor(request)
    if any(found.alarms.values()):
        show(out.console, alarm_table(found, watched))
    out.write({"--plot": lambda: draw(found, watched)})
    out.say(meaning(found), *found.notes)
    out.finish(f"stored in {shown(place)}: modelgap show {id}")


def wear(
    *runs: str,
    robot: str,
    model: str | None = None,
    json: Json = None,
    store: Store = None,
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
    """
    out = Outputs({"--json": json})
    with progress_bar() as progress:
        found = follow(store_folder(store), robot, runs, model, progress)
    out.write(document=lambda: document(found))
    if json != STDOUT:
        out.say(*([found.line] if found.line else []))
        show(out.console, wear_sentence(found), wear_table(found), WEAR_KEY)
        return
    out.finish()


def document(found: Wear) -> dict:
    """Return the outcome as plain values; changes are relative, NaN is null."""
    runs = zip(found.runs, found.days, found.sessions, found.change, strict=True)
    return plain(
        {
            "schema": 1,
            "robot": found.robot,
            "clock": found.clock,
            "time_constant": found.time,
            "joints": [
                {
                    "joint": one.joint,
                    "logs": one.logs,
                    "wear_per_30_days": one.wear and asdict(one.wear),
                    "cold_to_warm": one.warming and asdict(one.warming),
                    "why_not": one.why,
                }
                for one in found.joints
            ],
            "runs": [
                dict(zip(("run_id", "day", "session", "change"), run, strict=True))
                for run in runs
            ],
        }
    )
