"""modelgap init: a project of one's own."""

from pathlib import Path

from flows.cli.options import Flag
from flows.project.start import Start, start
from flows.settings import PROJECT


def init(
    folder: str = ".", /, *, robot: str | None = None, simulated: Flag = False
) -> None:
    """Write modelgap.toml: robots, inboxes, schedules, store, who is told.

    ```
    modelgap init --robot arm.urdf
    modelgap init cell4 --robot ur10_folder
    modelgap init trial --robot irb140 --simulated
    ```

    Every option is in the file, with a comment; what is commented out shows the
    default. Then put logs into inbox/ and start it: modelgap up. An existing file is
    never overwritten.

    Args:
        folder: Where; made if it is not there.
        robot: URDF file, folder with one and an optional robot.toml, or built-in name;
            what lies elsewhere is copied beside the file. The simulated IRB140 unless
            given.
        simulated: Let the nights run a campaign on a simulated arm of it.
    """
    project = start(Start(folder, robot, simulated))
    print(f"wrote {project.folder / PROJECT}")
    for inbox in project.table.inbox:
        print(f"logs of {inbox.robot} go into {project.path(inbox.folder)}")
    there = "" if project.folder == Path.cwd() else f" in {project.folder}"
    print(f"edit it if you like, then{there}: modelgap up")
