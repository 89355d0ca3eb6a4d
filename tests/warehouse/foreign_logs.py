"""Logs under the headers of public formats: the lines above, the names, own numbers."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from residual.recording import Recording

FOLDER = Path(__file__).with_name("foreign")


@dataclass(frozen=True, slots=True)
class Format:
    """Where time [s], angles [rad] and torques [N m] stand, and in which unit."""

    file: str
    separator: str
    time: tuple[str, float, float]  # column, units in a second, what it starts at
    q: Callable[[int], str]
    tau: Callable[[int], str]
    angle: float = 1.0  # units in a radian
    dof: int = 7

    @property
    def lines(self) -> list[str]:
        return (FOLDER / self.file).read_text(encoding="utf-8").splitlines()

    @property
    def head(self) -> list[str]:
        first = self.time[0] if self.file != "kuka_fri.dat" else "Counter"
        at = next(i for i, line in enumerate(self.lines) if line.startswith(first))
        return self.lines[: at + 1]

    def write(self, path: Path, log: Recording) -> Path:
        """Write a log; columns that are nothing of ours hold noise."""
        column, per_second, start = self.time
        own = {column: start + per_second * (log.t - log.t[0])}
        for j in range(self.dof):
            own[self.q(j)] = self.angle * log.q[:, j]
            own[self.tau(j)] = log.tau[:, j]
        names = [name.strip() for name in self.head[-1].split(self.separator)]
        noise = np.random.default_rng(34)
        table = [own.get(name, noise.normal(size=len(log.t))) for name in names]
        rows = (map(repr, map(float, row)) for row in zip(*table, strict=True))
        text = [*self.head, *(self.separator.join(row) for row in rows)]
        path.write_text("\n".join([*text, ""]), encoding="utf-8")
        return path


FORMATS = {
    "ur-rtde": Format(
        "ur_rtde.csv",
        " ",
        ("timestamp", 1.0, 10853.104),
        "actual_q_{}".format,
        "actual_current_as_torque_{}".format,
        dof=6,
    ),
    "franka": Format(
        "franka_log.csv",
        ",",
        ("time", 1000.0, 81230.0),
        "state.q[{}]".format,
        "state.tau_J[{}]".format,
    ),
    "kuka-fri": Format(
        "kuka_fri.dat",
        "\t",
        ("KRCTime", 1.0, 5.112),
        lambda j: f"ActPJ{j + 1}",
        lambda j: f"ActFJ{j + 1}",
        angle=180 / np.pi,
    ),
}
