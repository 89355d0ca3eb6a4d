"""Group 3: measured arms: does a consistent model reach what a free one does?"""

from benchmarks.figures import Figures, figure, missing
from benchmarks.measured_parts.arms import data_folder
from residual.identification.consistency import consistent
from residual.identification.identify import identify
from residual.identification.prove import torque_errors
from residual.robot.robot import load_robot
from warehouse.logs import read_log

_SPLITS = {
    "kr300": (("run_A.csv", "run_B.csv"), ("run_C.csv",)),
    "ur10": (("run.csv@:60%",), ("run.csv@60%:",)),
}


def measured_figures(quick: bool) -> Figures:
    """Identify each arm freely and consistently, and try both on unseen motion.

    Args:
        quick: Whether to take the smaller arm only.
    """
    folder, out = data_folder(), {}
    for name, parts in _SPLITS.items():
        if folder is None or (quick and name == "kr300"):
            why = "no measured logs" if folder is None else "the full run measures it"
            out[f"{name}_consistent_over_free"] = missing(None, why)
            continue
        robot = load_robot(folder / name / f"{name}.urdf")
        fit, held_out = (
            [read_log(f"{folder / name / word}", robot)[0] for word in part]
            for part in parts
        )
        found = identify(robot, fit)
        bodies = consistent(found)
        models = {
            "nominal": found.nominal,
            "free": found.model,
            "consistent": bodies.model,
        }
        errors = torque_errors(models, held_out)
        told = {k: round(e.overall("filtered"), 4) for k, e in errors.items()}
        out[f"{name}_consistent_over_free"] = figure(
            told["consistent"] / told["free"],
            None,
            1,
            held_out_percent=told,
            condition=found.estimate.condition,
            held=len(found.preflight.held),
            least_mass_matrix=bodies.least_mass_matrix,
        )
    return out
