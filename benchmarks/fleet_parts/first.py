"""From an empty folder, a URDF and three logs to a scheduled diagnosis of that robot.

The commands are those of docs/project.md, given as a user gives them, and counted. The
clock runs from the first one until the verdict is in the store and the next night of
that robot is due.
"""

import json
import shutil
import tempfile
from pathlib import Path
from time import monotonic

from benchmarks.figures import Figures, figure, missing
from benchmarks.fleet_parts.commands import modelgap, wait_for
from benchmarks.fleet_parts.made import arm, logs

COMMANDS, SECONDS, PATIENCE = 4, 180.0, 1200.0


def figures_of(quick: bool) -> Figures:
    """Return the figures of the group."""
    if quick:
        why = "a server and a diagnosis take longer than a quick run"
        return {
            "first_commands": missing(COMMANDS, why),
            "first_seconds": missing(SECONDS, why),
        }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "project"
        given, seconds, said = _served(Path(name), folder)
    about = {} if seconds is not None else {"why": said, "ok": False}
    return {
        "first_commands": figure(given, COMMANDS, 1),
        "first_seconds": figure(seconds, SECONDS, 1, **about),
    }


def _served(place: Path, folder: Path) -> tuple[int, float | None, str]:
    """Return how many commands it took, how long [s], and what was said otherwise."""
    (place / "logs").mkdir()
    made = logs(place / "logs")
    folder.mkdir()
    urdf = arm(place)
    begun = monotonic()
    steps = (
        lambda: modelgap("init", "--robot", str(urdf), folder=folder),
        lambda: [shutil.copy(log, folder / "inbox") for log in made],
        lambda: modelgap("up", folder=folder),
    )
    try:
        for step in steps:
            done = step()
            if getattr(done, "returncode", 0):
                return len(steps), None, done.stderr.strip()[-300:]
        if not wait_for(lambda: _is_done(folder), PATIENCE):
            return len(steps), None, f"no diagnosis after {PATIENCE:.0f} s"
        return len(steps), round(monotonic() - begun, 1), ""
    finally:
        modelgap("down", "--wait", "0", folder=folder)


def _is_done(folder: Path) -> bool:
    """Whether a diagnosis is in the store, and the next one of the robot is due."""
    if not any((folder / "store" / "diagnoses").glob("diagnosis_id=*")):
        return False
    told = json.loads(modelgap("status", "--json", folder=folder).stdout)
    due = {d["name"]: d["due"] for d in told["deployments"]}
    return due.get("diagnose-new/irb140") is not None
