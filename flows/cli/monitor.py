"""modelgap monitor: are the sensors of an arm as they were?"""

from dataclasses import replace
from typing import Annotated

from cyclopts import Parameter

from flows.cli.app import Outputs
from flows.report.console import show
from flows.report.monitoring import alarm_table, meaning
from flows.report.monitoring import plot as draw
from flows.requests import File, Flag, Monitor
from flows.settings import store_folder
from flows.steps import monitor as monitoring
from flows.steps.models import chosen_to_watch
from warehouse.remote import store_name

_HOURLY = Monitor()


def monitor(
    model: str,
    /,
    *runs: Annotated[str, Parameter(name="RUN")],
    request: Monitor = _HOURLY,
    nominal: Flag = False,
    plot: File = None,
) -> None:
    """Watch the sensors of runs, with limits from healthy runs.

    ```
    modelgap monitor irb140 3f2a --calibrate 01ab 02cd 03ef 04aa
    modelgap monitor 77e0 3f2a 4b1c --plot watched.png
    ```

    Encoders that freeze, jump or drift, torque sensors with a bias, a lost scale or
    spikes, noise of both: when, which joint, which sensor. In a closed loop an encoder
    that drifts slowly is hidden: the arm follows it (docs/monitoring.md).

    Args:
        model: Id of a diagnosis, or a robot (built-in name, URDF, folder) for the
            model that it has (modelgap models), else its nominal one, fitted to the
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
    out.finish(f"stored in {store_name(place)}: modelgap show {id}")
