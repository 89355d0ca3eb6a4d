"""Export a model in the form of another program."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

from flows.inputs.read import read_sets
from flows.requests import Export
from flows.settings import store_folder
from flows.steps.models import read_model
from flows.steps.rrd import make_rrd
from residual.errors import InputError, RunError, check_name
from residual.export.c99 import SOURCE, to_c99, to_fmu
from residual.export.export import AnyModel, ModelExport, to_json, without_tables
from residual.export.simulators import to_mjcf, to_mujoco, to_urdf
from residual.export.table import to_table
from residual.plugins import plugins
from residual.quantity import plain
from residual.recording import Recording

_FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-shared", "-fPIC")


def compiler() -> str | None:
    """Return the C compiler of this machine: $CC, else cc or gcc; None for none."""
    names = (os.environ.get("CC", ""), "cc", "gcc")
    return next((result for n in names if n and (result := shutil.which(n))), None)


def build(place: Path, sources: Sequence[str], name: str, *flags: str) -> None:
    """Compile files of a folder into a shared library there."""
    command = [compiler() or "cc", *_FLAGS, *flags, "-o", name, *sources, "-lm"]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True)
    if done.returncode:
        reason = next((x for x in done.stderr.splitlines() if "error" in x), "")
        raise RunError(f"The C compiler refuses the export: {reason[:160]}")


def build_fmu(sources: Mapping[str, bytes]) -> bytes | None:
    """Return the library of an FMU; None where there is no C compiler."""
    if compiler() is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_bytes(text)
        build(Path(folder), [SOURCE], "library.so", "-fvisibility=hidden")
        return (Path(folder) / "library.so").read_bytes()


Writer = Callable[[AnyModel], ModelExport]
TARGETS: Mapping[str, Writer] = {
    "urdf": to_urdf,
    "mjcf": to_mjcf,
    "mujoco": to_mujoco,
    "c99": to_c99,
    "table": to_table,
    "fmu": partial(to_fmu, build=build_fmu),
    "rrd": make_rrd,
    "json": to_json,
}


def targets() -> Mapping[str, Writer]:
    """Return all targets: ours, and those of plug-ins."""
    result = dict(TARGETS)
    for name, write in plugins("modelgap.exporters").items():
        if name in result or not callable(write):
            raise InputError(
                f"The plug-in '{name}' (modelgap.exporters): expected a function that "
                "takes a model, called as no other target is."
            )
        result[name] = write
    return result


def export(request: Export) -> ModelExport:
    """Read a model and write it in the form of another program.

    Raises:
        InputError: If there is no such model or target, the target cannot take the
            model, or a package that it needs is not installed.
    """
    check_name(request.to, targets(), "target")
    store = store_folder(request.store)
    model = read_model(store, request.model, request.which)
    if request.log is None:
        return export_model(model, request.to)
    sets, robot = ((request.log,), (), ()), without_tables(model).robot
    (log,) = read_sets(sets, robot, request.columns, store).fit
    return export_model(model, request.to, log)


def export_model(model: AnyModel, to: str, log: Recording | None = None) -> ModelExport:
    """Write a model in the form of another program.

    Args:
        log: A log of the robot, for a target that shows it.

    Raises:
        InputError: As `export`.
    """
    write = targets()[check_name(to, targets(), "target")]
    if log is not None and write is not make_rrd:
        raise InputError(f"A log is of no use for {to}: it goes with rrd alone.")
    return write(model) if log is None else make_rrd(model, log)


def words(result: ModelExport) -> list[str]:
    """Return the model and the omissions of an export, a line each."""
    lines = [f"model: {result.source!r}"]
    lines += [f"not exported: {omission}" for omission in result.omissions]
    if len(result.omissions) > 1:
        size = f"up to {result.largest:.3g} N m (rms {result.rms:.3g})"
        lines.append(f"not exported, together: {size}")
    if not result.omissions:
        lines.append("the export represents the whole model")
    return lines


def document(result: ModelExport) -> dict:
    """Return the omissions of an export as plain values."""
    return {
        "schema": 1,
        "files": sorted(result.files),
        "left": plain([asdict(each) for each in result.omissions]),
        "missing": {"rms": result.rms, "largest": result.largest},
    }


def in_place(result: ModelExport, folder: str | Path) -> dict[Path, bytes]:
    """Return the files of an export by where they go."""
    return {Path(folder) / name: text for name, text in result.files.items()}
