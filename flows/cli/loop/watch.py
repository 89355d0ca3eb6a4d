"""modelgap watch: is the arm as it was? While it runs."""

from functools import partial
from pathlib import Path

from rich.console import Console

from flows.cli.options import Flag, Words
from flows.errors import RunError
from flows.inputs.stream.file import GrowingFile
from flows.inputs.stream.folder import FillingFolder
from flows.inputs.stream.socket import LocalPort
from flows.inputs.stream.source import Meaning, Source
from flows.outputs import say
from flows.report.monitoring import alarm_line, end_line
from flows.report.words.verdict import headline
from flows.service.status import start_diagnosis
from flows.settings import store_folder
from flows.steps import diagnose as diagnosis
from flows.steps.watch.alarm import (
    keep_alarm,
    keep_run,
    long_enough,
    request_of,
)
from flows.steps.watch.run import Shell
from flows.steps.watch.run import watch as run
from flows.steps.watch.session import Session
from flows.steps.watch.start import Begun, Watch, start
from flows.storage.diagnosis import read_verdict
from residual.errors import InputError, ModelgapError
from residual.monitoring.learn import PER_HOUR
from residual.monitoring.rows import Samples
from residual.monitoring.watch import Change
from warehouse.logs import ColumnMap, load_columns


def watch(
    robot: str,
    /,
    *,
    file: str | None = None,
    folder: str | None = None,
    listen: str | None = None,
    calibrate: Words = (),
    model: str | None = None,
    map: str | None = None,
    per_hour: float = PER_HOUR,
    state: str | None = None,
    once: Flag = False,
    alarms_only: Flag = False,
    store: str | None = None,
) -> None:
    """Watch a robot while it runs; say what has changed, and diagnose it.

    ```
    modelgap watch irb140 --file today.csv --calibrate 01ab 02cd 03ef 04aa
    modelgap watch irb140 --folder /var/log/arm
    modelgap watch irb140 --listen 5005
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
        file: CSV or JSON lines that grow; half a line is waited for.
        folder: Folder into which such files are put, read in the order of their names.
        listen: PORT or HOST:PORT of this machine, to which such lines are sent.
        calibrate: Ids of healthy runs, three or more, such as will be watched, cold and
            warm. Needed once: the state remembers what was learnt.
        model: "nominal", or the id of a diagnosis, in place of the model that it has.
        map: TOML file that says which column is what, in which unit.
        per_hour: False alarms wanted at most in an hour.
        state: File of the state; without it one in the store.
        once: Read what is there, diagnose, and stop.
        alarms_only: Store alarms and their rows, and diagnose nothing.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    console = Console()
    tell = partial(say, console)
    _one_of(file, folder, listen)
    begun = start(Watch(robot, calibrate, model, per_hour, state, store))
    meaning = Meaning(begun.robot, load_columns(map) if map else ColumnMap())
    source = _source((file, folder, listen), meaning, begun.session.position)
    say(console, *begun.lines, f"reading {source.name}; Ctrl-C stops, nothing is lost")
    place = store_folder(store)
    session = begun.session

    def diagnose(now: Session, samples: Samples, alarm: Change) -> None:
        _alarmed(now, samples, alarm, (place, robot, begun, alarms_only), tell)

    shell = Shell(source, begun.path, tell, lambda a: tell(alarm_line(a)), diagnose)
    try:
        session = run(session, shell, once)
    except KeyboardInterrupt:
        tell(f"stopped; {begun.path} knows where. The same command goes on there.")
        raise
    say(console, end_line(session))


def _one_of(*given: str | None) -> None:
    if sum(one is not None for one in given) != 1:
        raise InputError(
            "Where do the rows come from? Give one of --file FILE, --folder DIR and "
            "--listen PORT."
        )


def _source(
    given: tuple[str | None, ...], meaning: Meaning, position: dict | None
) -> Source:
    file, folder, listen = given
    if file is not None:
        return GrowingFile.at(Path(file), meaning, position)
    if folder is not None:
        return FillingFolder.at(Path(folder), meaning, position)
    return LocalPort.at(str(listen), meaning)


def _alarmed(
    session: Session,
    samples: Samples,
    alarm: Change,
    about: tuple[Path, str, Begun, bool],
    tell,
) -> None:
    """Keep an alarm and its rows, and have them diagnosed; a failure ends no watch."""
    store, word, begun, alarms_only = about
    run_id = keep_run(store, word, begun.robot, samples)
    begin = float(samples.t[0])
    id = keep_alarm(store, session, run_id, begin, alarm)
    tell(f"stored: alarm {id[:8]}, its rows as run {run_id[:8]}")
    if alarms_only:
        return
    if not long_enough(samples):
        tell("too few rows for a diagnosis: the stream ended soon after the alarm")
        return
    request = request_of(session, run_id, word, store)
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
