"""Export a model, and try the export in the program that it is for."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from flows.inputs.given import read_sets
from flows.proofs.proof import (
    Proof,
    Prove,
    make_fmu,
    prove_c99,
    prove_fmu,
    prove_json,
    prove_mjcf,
    prove_mujoco,
    prove_numpy,
    prove_table,
    prove_urdf,
)
from flows.proofs.rrd import make_rrd, prove_rrd
from flows.requests import Export
from flows.settings import store_folder
from flows.steps.models import read_model
from residual.errors import InputError, check_name
from residual.export.c99 import to_c99
from residual.export.exported import Exported, Whole, body_of, to_json
from residual.export.mujoco import to_mujoco
from residual.export.numpy_file import to_numpy
from residual.export.simulators import to_mjcf, to_urdf
from residual.export.table import to_table
from residual.lazy import plugins
from residual.quantity import plain
from residual.recording import Recording

TARGETS: Mapping[str, tuple[Callable[[Whole], Exported], Prove]] = {
    "urdf": (to_urdf, prove_urdf),
    "mjcf": (to_mjcf, prove_mjcf),
    "mujoco": (to_mujoco, prove_mujoco),
    "c99": (to_c99, prove_c99),
    "numpy": (to_numpy, prove_numpy),
    "table": (to_table, prove_table),
    "fmu": (make_fmu, prove_fmu),
    "rrd": (make_rrd, prove_rrd),
    "json": (to_json, prove_json),
}


def targets() -> Mapping[str, tuple[Callable[[Whole], Exported], Prove]]:
    """Return all targets: ours, and a writer, or writer and proof, of each plug-in."""
    found = dict(TARGETS)
    for name, given in plugins("modelgap.exporters").items():
        write, prove = given if isinstance(given, tuple) else (given, _untried)
        if name in found or not callable(write):
            raise InputError(
                f"The plug-in '{name}' (modelgap.exporters): expected a function that "
                "takes a model, called as no other target is."
            )
        found[name] = write, prove
    return found


def _untried(made: Exported) -> Proof:
    return Proof("a plug-in, which brings no proof of its own", 0, None, 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Made:
    """An export and its proof.

    Attributes:
        export: Files, and what is not in them.
        proof: What came back out of the target.
    """

    export: Exported
    proof: Proof


def export(request: Export) -> Made:
    """Read a model, write it in the form of another program, and try it there.

    Raises:
        InputError: If there is no such model or target, the target cannot take the
            model, or a package that it needs is not installed.
        RunError: If the target refuses what was written.
    """
    check_name(request.to, targets(), "target")
    store = store_folder(request.store)
    model = read_model(store, request.model, request.which)
    if request.log is None:
        return export_model(model, request.to)
    sets, robot = ((request.log,), (), ()), body_of(model).robot
    (log,) = read_sets(sets, robot, request.columns, store).fit
    return export_model(model, request.to, log)


def export_model(model: Whole, to: str, log: Recording | None = None) -> Made:
    """Write a model in the form of another program, and try it there.

    Args:
        log: A log of the robot, for a target that shows it.

    Raises:
        InputError: As `export`.
        RunError: As `export`.
    """
    write, prove = targets()[check_name(to, targets(), "target")]
    if log is not None and write is not make_rrd:
        raise InputError(f"A log is of no use for {to}: it goes with rrd alone.")
    made = write(model) if log is None else make_rrd(model, log)
    return Made(made, prove(made))


def words(made: Made) -> list[str]:
    """Return what is to be said of an export, a line each."""
    found = made.export
    lines = [f"model: {found.whole!r}"]
    lines += [f"not carried: {left}" for left in found.left]
    if len(found.left) > 1:
        lines.append(
            f"not carried, together: up to {found.largest:.3g} N m "
            f"(rms {found.rms:.3g})"
        )
    if not found.left:
        lines.append("everything of the model is carried")
    return [*lines, str(made.proof), *made.proof.notes]


def document(made: Made) -> dict:
    """Return an export as plain values: what is left out, and its proof."""
    found = made.export
    return {
        "schema": 1,
        "files": sorted(found.files),
        "left": plain([asdict(each) for each in found.left]),
        "missing": {"rms": found.rms, "largest": found.largest},
        "proof": plain(asdict(made.proof)),
    }


def in_place(made: Made, folder: str | Path) -> dict[Path, bytes]:
    """Return the files of an export by where they go."""
    return {Path(folder) / name: text for name, text in made.export.files.items()}
