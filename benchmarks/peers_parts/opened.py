"""What a program is given of an exported study, and the answer that it writes."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

Array = np.ndarray


@dataclass(frozen=True, eq=False, slots=True)
class Log:
    """One log.

    Attributes:
        t: Time of the session [s]. Shape (n,).
        q: Positions [rad]. Shape (n, dof).
        tau: Torques [N m], shape (n, dof); None where they are to be predicted.
    """

    t: Array
    q: Array
    tau: Array | None


@dataclass(frozen=True)
class Case:
    """One case of an exported study; nothing under ``sealed`` is read.

    Attributes:
        folder: The folder ``open``.
        name: Name of the case.
    """

    folder: Path
    name: str

    @cached_property
    def entry(self) -> Mapping:
        """Its robot and the names of its logs."""
        content = json.loads((self.folder / "cases.json").read_text(encoding="utf-8"))
        return content["cases"][self.name]

    @property
    def urdf(self) -> str:
        """Text of the robot's URDF."""
        name = self.entry["robot"]
        path = self.folder / "robots" / name / f"{name}.urdf"
        return path.read_text(encoding="utf-8")

    @cached_property
    def declared(self) -> Mapping:
        """What else is stated of the robot."""
        path = self.folder / "robots" / self.entry["robot"] / "declared.json"
        return json.loads(path.read_text(encoding="utf-8"))

    def logs(self, role: str) -> dict[str, Log]:
        """Return its logs of a role, by name: "fit", "held_out" or "after"."""
        return {name: self._read(name) for name in self.entry[role]}

    def _read(self, name: str) -> Log:
        path = self.folder / "logs" / self.name / f"{name}.csv"
        with path.open(encoding="utf-8") as file:
            head = file.readline().strip().split(",")
            rows = np.loadtxt(file, delimiter=",", ndmin=2)
        of = {
            s: [i for i, h in enumerate(head) if h[: len(s)] == s] for s in ("q", "tau")
        }
        tau = rows[:, of["tau"]] if of["tau"] else None
        return Log(rows[:, 0], rows[:, of["q"]], tau)


@dataclass(frozen=True, eq=False, slots=True)
class Answer:
    """What a program says of one case.

    Attributes:
        findings: As README.md of the export has them.
        unknown: Whether, or on which joints, something is left that has no name.
        predictions: Torque by name of the file [N m]. Shapes (n, dof).
    """

    findings: tuple[Mapping, ...]
    unknown: bool | list[int] = False
    predictions: Mapping[str, Array] = field(default_factory=dict)

    @property
    def entry(self) -> dict:
        """Its place in an answers file."""
        return {"findings": list(self.findings), "unknown": self.unknown}

    def write(self, folder: Path) -> None:
        """Write the predictions as CSV."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, tau in self.predictions.items():
            head = ",".join(f"tau{i}" for i in range(1, tau.shape[1] + 1))
            path = folder / f"{name}.csv"
            np.savetxt(path, tau, "%.6g", ",", header=head, comments="")
