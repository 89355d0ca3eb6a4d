"""modelgap watch, monitor and wear: is the arm, and are its sensors, as they were?"""

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from flows.cli.app import STDOUT, Outputs
from flows.inputs.stream import GrowingFile, StandardInput
from flows.outputs import progress_bar, say
from flows.report.console import show
from flows.report.figures.scores import plot as draw
from flows.report.monitoring import (
    WEAR_KEY,
    alarm_line,
    alarm_table,
    end_line,
    meaning,
    wear_sentence,
    wear_table,
)
from flows.report.words.verdict import headline
from flows.requests import Columns, Diagnose, Flag, Json, Monitor, Store
from flows.service.api import start_diagnosis
from flows.settings import store_folder
from flows.steps import diagnose as diagnosis
from flows.steps import monitor as monitoring
from flows.steps.models import chosen_to_watch
from flows.steps.monitor import Wear, follow
from flows.steps.watch.run import (
    Shell,
    keep_alarm,
    keep_run,
    long_enough,
    request_of,
)
from flows.steps.watch.run import watch as run
from flows.steps.watch.session import Session, Watch, start
from flows.storage.diagnosis import read_verdict
from residual.errors import InputError, ModelgapError, RunError
from residual.monitoring.rows import Samples
from residual.monitoring.watch import Change
from residual.quantity import plain
from warehouse.logs import ColumnMap, columns_of
from warehouse.mirror import shown

_PLAIN, _HOURLY = Watch(), Monitor()


def watch(
    robot: str,
    /,
    *,
    request: Watch = _PLAIN,
    file: str,
    columns: Columns = None,
    once: Flag = False,
    alarms_only: Flag = False,
) -> None:
    """Watch a robot while it runs; say what has changed, and diagnose it.

    ```
    modelgap watch irb140 --file today.csv --calibrate 01ab 02cd 03ef 04aa
    logger_of_the_arm | modelgap watch irb140 --file -
    ```

    From healthy runs it learns what the model of the robot leaves; then it reads rows
    as they come. A load on the flange, a gain, bias or friction of a joint that is
    no longer as it was raises an alarm with its size; the rows around it become a run
    of the store, and that is diagnosed: by the service where one is up (modelgap up),
    else here. Ctrl-C loses nothing: the same command goes on where it stopped
    (docs/watch.md).

    Args:
        robot: Built-in name (irb140), URDF file or folder. It goes by the model that
            it has in the store (modelgap models).
        file: CSV or JSON lines that grow; half a line is waited for. "-" is standard
            input, such lines down a pipe.
        once: Read what is there, diagnose, and stop.
        alarms_only: Store alarms and their rows, and diagnose nothing.
    """
    if once and file != STDOUT and not Path(file).exists():
        # Without --once it may come yet; with it a wrong name would be "0 alarms".
        raise InputError(
            f"--file {file}: there is no such file, and with --once none is waited for."
        )
    console = Console()
    tell = partial(say, console)
    begun = start(replace(request, robot=robot))
    arm = begun.robot, columns_of(begun.robot, columns) or ColumnMap()
    source = (
        StandardInput(*arm)
        if file == STDOUT
        else GrowingFile(Path(file), *arm, begun.session.position)
    )
    say(console, *begun.lines, f"reading {source.name}; Ctrl-C stops, nothing is lost")
    store = store_folder(request.store)

    def diagnose(now: Session, samples: Samples, alarm: Change) -> None:
        run_id = keep_run(store, robot, begun.robot, samples)
        id = keep_alarm(store, now, run_id, float(samples.t[0]), alarm)
        tell(f"stored: alarm {id[:8]}, its rows as run {run_id[:8]}")
        if alarms_only:
            return
        if not long_enough(samples):
            tell("too few rows for a diagnosis: the stream ended soon after the alarm")
            return
        _diagnosed(request_of(now, run_id, robot, store), store, tell)

    shell = Shell(source, begun.path, tell, lambda a: tell(alarm_line(a)), diagnose)
    try:
        session = run(begun.session, shell, once)
    except KeyboardInterrupt:
        tell(f"stopped; {begun.path} knows where. The same command goes on there.")
        raise
    say(console, end_line(session))


def _diagnosed(request: Diagnose, store: Path, tell: Callable[[str], None]) -> None:
    """Have the rows about an alarm diagnosed; a failure ends no watch."""
    try:
        started = start_diagnosis(request, store)
        if started:
            tell(f"diagnosis started: flow run {started} (modelgap status)")
            return
        tell("diagnosing the rows around the alarm ...")
        diagnosed, _ = diagnosis.diagnose_runs(request)
    except (ModelgapError, RunError) as error:
        tell(f"no diagnosis: {error}")
        return
    tell(f"diagnosis: {headline(read_verdict(store, diagnosed))}")
    tell(f"stored as a diagnosis: modelgap show {diagnosed}")


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
