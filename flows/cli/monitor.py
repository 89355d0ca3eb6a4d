"""modelgap monitor: do the sensors of a robot still tell the truth?"""

from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from flows.cli.options import Flag, Words, named_files
from flows.outputs import check_writable, say, write_all
from flows.report.console import show
from flows.report.figures.scores import plot as draw
from flows.report.monitoring import alarm_table, meaning
from flows.requests import Monitor
from flows.settings import store_folder
from flows.steps import monitor as steps
from flows.steps.loop.choose import choose_to_watch
from warehouse.objects.mirror import shown


def monitor(
    model: str,
    /,
    *runs: Annotated[str, Parameter(name="RUN")],
    calibrate: Words = (),
    per_hour: float = 1.0,
    nominal: Flag = False,
    plot: str | None = None,
    store: str | None = None,
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
        calibrate: Ids of healthy runs, three or more; without it those that the
            diagnosis was made from.
        per_hour: False alarms wanted at most in an hour.
        nominal: Of a robot take the nominal model, whatever it has.
        plot: PNG file for the scores over time.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place, console = store_folder(store), Console()
    files = named_files({"--plot": plot})
    check_writable(files, ())
    choice = choose_to_watch(model, place, nominal, runs)
    say(console, *choice.lines)
    request = Monitor(choice.diagnosis or model, runs, calibrate, per_hour, place)
    id, found, watched = steps.monitor(request)
    if any(found.alarms.values()):
        show(console, alarm_table(found, watched))
    write_all({path: draw(found, watched) for path in files.values()})
    lines = [meaning(found), *found.notes, *(f"wrote {f}" for f in files.values())]
    say(console, *lines, f"stored in {shown(place)}: modelgap show {id}")
