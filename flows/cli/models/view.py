"""modelgap view: a log as the arm moves, in a page for the browser."""

from pathlib import Path

from rich.console import Console

from flows.model_requests import View
from flows.outputs import check_outside, check_writable, read_files, say, write_all
from flows.report.view import render
from flows.settings import store_folder
from flows.steps import view as steps

_PAGE = "view.html"


def view(
    log: str,
    *,
    robot: str | None = None,
    verdict: str | None = None,
    out: str = _PAGE,
    map: str | None = None,
    store: str | None = None,
) -> None:
    """Show a log as the arm moves: torque, residual and effects beside it.

    Writes one HTML file that needs nothing else, for any browser that draws 3-D. The
    arm has the shapes of its URDF, with meshes where their files are found beside it;
    links without shapes are rods.

    ```
    modelgap view e125 --verdict f4b4
    modelgap view monday.csv --robot arm.urdf --out monday.html
    ```

    Args:
        log: CSV, Parquet, ROS bag or MCAP, a window as in FILE@0:16.5, or the id of a
            run of the store.
        robot: Built-in name (irb140), URDF file, or folder with one *.urdf; a run of
            the store and a verdict know theirs.
        verdict: Id of a diagnosis of the store: its models predict the torque, and
            each of its findings is drawn.
        out: Page to write.
        map: TOML file that says which column is what, in which unit.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    console = Console()
    check_outside("--out", out, store_folder(store))
    path = Path(out)
    inputs = [word for word in (log, robot) if word]
    check_writable({"--out": path}, read_files(inputs, map))
    found = steps.view(View(log, robot, verdict, map, store))
    say(console, *found.lines)
    if found.look.lacking:
        some = ", ".join(found.look.lacking[:3])
        say(console, f"rods instead of meshes that were not found: {some}")
    write_all({path: render(found)})
    say(console, f"wrote {path}")
