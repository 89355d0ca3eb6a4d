"""modelgap monitor: do the sensors of a robot still tell the truth?"""

from typing import Annotated

from cyclopts import Parameter

from flows.say import say

_Runs = Annotated[tuple[str, ...], Parameter(consume_multiple=(1, None), negative="")]


def monitor(
    model: str,
    /,
    *runs: Annotated[str, Parameter(name="RUN")],
    calibrate: _Runs = (),
    per_hour: float = 1.0,
    plot: str | None = None,
    store: str | None = None,
) -> None:
    """Watch the sensors of runs, with limits from runs in good order.

    ```
    modelgap monitor irb140 3f2a --calibrate 01ab 02cd 03ef 04aa
    modelgap monitor 77e0 3f2a 4b1c --plot watched.png
    ```

    Encoders that freeze, jump or wander off, torque sensors with a bias, a lower gain
    or spikes: when, which joint, which sensor. In a closed loop an encoder that drifts
    slowly is hidden: the arm follows it (docs/monitoring.md).

    Args:
        model: Id of a diagnosis, or a robot (built-in name, URDF, folder) for its
            nominal model. Its coefficients are fitted to the good runs.
        runs: Ids of the runs to watch; the beginning is enough.
        calibrate: Ids of runs in good order, three or more; without it those that the
            diagnosis was made from.
        per_hour: False alarms wanted at most in an hour.
        plot: PNG file for the scores over time.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    from pathlib import Path

    from rich.console import Console

    from flows.outputs import check_writable, write_all
    from flows.settings import store_folder
    from flows.steps import monitor as steps

    place, console = store_folder(store), Console()
    files = {"--plot": Path(plot)} if plot else {}
    check_writable(files, ())
    id, found, watched = steps.monitor(model, runs, calibrate, place, per_hour)
    if any(found.alarms.values()):
        console.print(_table(found, watched))
    lines = [meaning(found), *found.notes]
    for path in files.values():
        from flows.report.page.monitor_plot import plot as draw

        write_all({path: draw(found, watched)})
        lines.append(f"wrote {path}")
    say(console, *lines, f"stored in {place}: modelgap show {id}")


def meaning(found) -> str:
    """Return what was found, in one sentence.

    Args:
        found: A ``flows.steps.monitor.Watched``.
    """
    alarms = [alarm for each in found.alarms.values() for alarm in each]
    count, runs = len(alarms), len(found.alarms)
    where = f"{found.seconds:.4g} s of {_many(runs, 'run')}"
    basis = (
        f"limits from {_many(len(found.calibration), 'good run')} of "
        f"{60 * found.monitor.hours:.3g} min, false alarms at most "
        f"{found.monitor.per_hour:g} an hour"
    )
    if count == 0:
        return f"No alarm in {where}: every sensor is as in the good runs ({basis})."
    joints = sorted({(a.sensor, a.joint) for a in alarms})
    which = ", ".join(f"{sensor} of joint {joint}" for sensor, joint in joints)
    return f"{_many(count, 'alarm')} in {where}: {which} ({basis})."


def _many(count: int, word: str) -> str:
    return f"{count} {word}" if count == 1 else f"{count} {word}s"


def _table(found, watched):
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for title in ("run", "since start \\[s]", "joint", "sensor", "fault", "over limit"):
        numbers = title not in ("run", "sensor", "fault")
        table.add_column(title, justify="right" if numbers else "left")
    for id, alarms in found.alarms.items():
        for alarm in alarms:
            since = alarm.time - watched[id].t[0]
            words = (f"{since:.3f}", str(alarm.joint), alarm.sensor, alarm.fault)
            table.add_row(id[:8], *words, f"{alarm.score:.3g}x")
    return table
