"""All commands by name. Each loads what it needs only when it runs."""

import re
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version

from cyclopts import App

from flows.cli.blind import blind
from flows.cli.bundle import bundle, unbundle
from flows.cli.calibrate import calibrate
from flows.cli.demo import demo
from flows.cli.diagnose import diagnose
from flows.cli.diff import diff, lineage
from flows.cli.experiment import campaign, experiment
from flows.cli.identify import identify
from flows.cli.imports import import_
from flows.cli.monitor import monitor
from flows.cli.null import calibrate_null
from flows.cli.rerun import rerun
from flows.cli.service import down, status, up
from flows.cli.store import compact, runs, show, sql
from flows.cli.trajectory import trajectory
from flows.cli.validate import validate

_HELP = """Find what a robot's dynamic model is missing.

The missing effect is named, added to the model, and proved on motion that was not
fitted. Start with one of these:

```
modelgap demo
modelgap diagnose A.csv B.csv --robot arm.urdf --holdout C.csv
```

The first makes an arm with an effect that its model is not told of; the second takes
your own logs. `modelgap COMMAND --help` explains a command.

Exit codes: 0 done, whatever the verdict; 1 the run failed; 2 bad usage or input;
130 interrupted.
"""


_LOGS = "LOG... --robot ROBOT [OPTIONS]"


def _version() -> str:
    try:
        return version("modelgap")
    except PackageNotFoundError:
        return "not installed"


app = App(
    name="modelgap",
    help=_HELP,
    help_format="markdown",
    version=_version,
    suppress_keyboard_interrupt=False,
)
app.command(diagnose, usage="Usage: modelgap diagnose LOG... --robot ROBOT [OPTIONS]")
app.command(identify, usage="Usage: modelgap identify LOG... --robot ROBOT [OPTIONS]")
app.command(calibrate, usage="Usage: modelgap calibrate LOG... --robot ROBOT [OPTIONS]")
app.command(calibrate_null, usage=f"Usage: modelgap calibrate-null {_LOGS}")
app.command(
    import_,
    name="import",
    usage="Usage: modelgap import LOG... --robot ROBOT [OPTIONS]",
)
app.command(demo)
app.command(blind)
app.command(experiment)
app.command(campaign)
app.command(trajectory)
app.command(validate)
app.command(monitor, usage="Usage: modelgap monitor MODEL RUN... [OPTIONS]")
app.command(rerun)
app.command(diff)
app.command(lineage)
app.command(bundle)
app.command(unbundle)
app.command(runs)
app.command(sql)
app.command(compact)
app.command(show)
app.command(up)
app.command(status)
app.command(down)


def run(words: Sequence[str]) -> None:
    """Run one command; every error is left to the caller.

    Args:
        words: Command line without the program's name.

    Raises:
        CycloptsError: On bad usage.
    """
    # The parser takes a lone "-" for an option unless it is tied to one.
    tied = re.sub(r"(^|\0)--json\0-(?=\0|$)", r"\1--json=-", "\0".join(words))
    # Without a name it asks which there are.
    tied = re.sub(r"(^|\0)--named(?=\0-|$)", r"\1--named=list", tied)
    app(
        tied.split("\0") if tied else [],
        exit_on_error=False,
        print_error=False,
        result_action="return_value",
    )
