"""modelgap monitor."""

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

_DEFAULT = Monitor()


def monitor(
    model: str,
    /,
    *runs: Annotated[str, Parameter(name="RUN")],
    request: Monitor = _DEFAULT,
    nominal: Flag = False,
    plot: File = None,
) -> None:
    """Monitor the sensors of runs, with limits from healthy runs.

    ```
    modelgap monitor irb140 3f2a --calibrate 01ab 02cd 03ef 04aa
    modelgap monitor 77e0 3f2a 4b1c --plot watched.png
    ```

    Reports time, joint and sensor of encoders that freeze, jump or drift, of torque
    sensors with a bias, a lost scale or spikes, and of noise. In a closed loop a slow
    drift of an encoder does not show: the arm follows it (docs/monitoring.md).

    Args:
        model: Id of a diagnosis, or a robot (built-in name, file, folder) for its
            adopted model (modelgap models), else its nominal model fitted to the
            healthy runs.
        runs: Ids of the runs, or their beginnings.
        nominal: Use the nominal model of the robot, also where one is adopted.
        plot: PNG file for the scores over time.
    """
    place = store_folder(request.store)
    out = Outputs({"--plot": plot})
    choice = chosen_to_watch(model, place, nominal, runs)
    out.say(*choice.lines)
    request = replace(request, model=choice.diagnosis or model, runs=runs, store=place)
    id, outcome, watched = monitoring.monitor(request)
    if any(outcome.alarms.values()):
        show(out.console, alarm_table(outcome, watched))
    out.write({"--plot": lambda: draw(outcome, watched)})
    out.say(meaning(outcome), *outcome.notes)
    out.finish(f"stored in {store_name(place)}: modelgap show {id}")
