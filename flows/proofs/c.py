"""A C99 header, compiled and run."""

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import numpy as np

from flows.errors import RunError
from flows.proofs.proof import Proof, compared
from residual.export.c99 import prefix_of
from residual.export.exported import Exported, Motion, body_of, exciting
from residual.recording import Array

FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-shared", "-fPIC")
AROUND = """\
#include "{header}"
void along(int n, const double *t, const double *q, const double *qd,
           const double *qdd, double *tau)
{{
    {p}_memory memory;
    {p}_start(&memory);
    for (int i = 0; i < n; i++)
        {p}_torque(&memory, t[i], q + {dof} * i, qd + {dof} * i, qdd + {dof} * i,
                   tau + {dof} * i);
}}
"""


def compiler() -> str | None:
    """Return the C compiler of this machine: $CC, else cc or gcc; None for none."""
    names = (os.environ.get("CC", ""), "cc", "gcc")
    return next((found for n in names if n and (found := shutil.which(n))), None)


def prove_c99(made: Exported) -> Proof:
    """Compile the header and run it along a motion; its time per call is a note.

    Raises:
        RunError: If the header does not compile.
    """
    if compiler() is None:
        return Proof("no C compiler here (cc, gcc or $CC)", 0, None, 0.0)
    motion = exciting(body_of(made.whole).robot)
    with compiled(made) as along:
        got = along(motion)
        start = perf_counter()
        along(motion)
        each = (perf_counter() - start) / len(motion.t)
    want = made.carried.along(motion.t, motion.parts)
    note = f"{1e6 * each:.2g} microseconds a call"
    return compared("compiled with the C compiler of this machine", got, want, (note,))


@contextmanager
def compiled(made: Exported) -> Iterator:
    """Give the compiled header as a function of a motion, while it is needed."""
    dof, (name, text) = body_of(made.whole).robot.dof, next(iter(made.files.items()))
    p = prefix_of(name.removesuffix(".h"))
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / name).write_bytes(text)
        source = AROUND.format(header=name, p=p, dof=dof)
        (place / "around.c").write_text(source, encoding="utf-8")
        build(place, ["around.c"], "around.so")
        library = ctypes.CDLL(str(place / "around.so"))

        def along(motion: Motion) -> Array:
            arrays = [np.ascontiguousarray(x) for x in (motion.t, *motion.parts)]
            out = np.empty_like(motion.q)
            ends = [x.ctypes.data_as(ctypes.c_void_p) for x in (*arrays, out)]
            library.along(len(motion.t), *ends)
            return out

        yield along


def build(place: Path, sources: list[str], name: str, *flags: str) -> None:
    """Compile files of a folder into a shared library there.

    Raises:
        RunError: If the compiler refuses them.
    """
    command = [compiler() or "cc", *FLAGS, *flags, "-o", name, *sources, "-lm"]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True)
    if done.returncode:
        reason = next((x for x in done.stderr.splitlines() if "error" in x), "")
        raise RunError(f"The C compiler refuses the export: {reason[:160]}")
