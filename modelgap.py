# ruff: noqa: F401  the names of the door, for editors
"""Find what a robot's dynamic model is missing, from a script or a notebook.

    import modelgap as mg

    robot = mg.load_robot("irb140")
    fit = mg.read_logs(["fit_1.csv", "fit_2.csv"], robot)
    test = mg.read_logs(["held_out.csv"], robot)
    found = mg.diagnose(robot, fit, held_out=test)
    found.save_report("out.html")

See docs/api.md. Each name is loaded on first use, so that importing this module loads no
numerics, scheduler, physics engine, database or plotting library.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for editors
    from flows.api.logs import check, compare, export, import_logs, load_robot, read_logs, recording
    from flows.api.loop import Experiment, monitor, next_experiment, simulate
    from flows.api.results import (
        Calibration,
        Diagnosis,
        Identification,
        calibrate,
        diagnose,
        identify,
    )
    from flows.api.store import Store, Table, open_store
    from residual.check.result import LogCheck
    from residual.errors import InputError
    from residual.identification.estimate import Options
    from residual.model.model import Model
    from residual.model.model_files import load_model
    from residual.recording import Recording
    from residual.robot.robot import Robot
    from residual.verdict.result import ErrorTables, Finding, Parameter, Verdict

_NAMES = {
    "flows.api.logs": "check compare export import_logs load_robot read_logs recording",
    "flows.api.loop": "Experiment monitor next_experiment simulate",
    "flows.api.results": "Calibration Diagnosis Identification calibrate diagnose identify",
    "flows.api.store": "Store Table open_store",
    "residual.check.result": "LogCheck",
    "residual.verdict.result": "ErrorTables Finding Parameter Verdict",
    "residual.errors": "InputError",
    "residual.identification.estimate": "Options",
    "residual.model.model": "Model",
    "residual.model.model_files": "load_model",
    "residual.recording": "Recording",
    "residual.robot.robot": "Robot",
}
_PLACE = {name: place for place, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_PLACE)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Load a name when it is first used."""
    if name not in _PLACE:
        raise AttributeError(f"module 'modelgap' has no attribute {name!r}")
    found = globals()[name] = getattr(import_module(_PLACE[name]), name)
    return found


def __dir__() -> list[str]:
    """Every name, also those that are not loaded yet."""
    return sorted({*globals(), *__all__})
