"""What is usual of an arm that is in order: what a stream is held against.

Rows become columns: what the first epoch leaves of the torque, the directions in which
it is not sure, what any arm does slowly, and what each change would add. A row is
judged by itself, with the friction of its velocity's sign.
"""

import base64
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields

import numpy as np

from residual.effects import registry
from residual.epochs.rules import Watching
from residual.epochs.window import BODY, Usual
from residual.errors import InputError, shown
from residual.model.model import Model, torque_columns, with_slots
from residual.monitoring.rows import Rows, Window, beyond
from residual.monitoring.rules import MONITOR
from residual.monitoring.usual import Tail
from residual.recording import Array
from residual.robot.robot import Robot

FORM = 2
LOAD, KINDS = "load", ("friction", "bias", "gain")  # in the order of evidence
UNITS = {LOAD: "kg", "gain": "1", "bias": "N m", "friction": "N m"}
_ARRAYS = ("theta", "basis", "friction", "limits", "lowest", "highest")
_PLAIN = ("rate", "per_hour", "hours")


def packed(values: Array) -> dict:
    """Return an array as JSON can hold it, to the last bit."""
    values = np.ascontiguousarray(values)
    bits = base64.b64encode(values.tobytes()).decode()
    return {"kind": values.dtype.str, "shape": list(values.shape), "bits": bits}


def unpacked(record: Mapping) -> Array:
    """Return the array of a record."""
    bits = base64.b64decode(record["bits"])
    return np.frombuffer(bits, record["kind"]).reshape(record["shape"]).copy()


def packed_fields(record) -> dict:
    """Return a record of arrays as JSON can hold it."""
    return {f.name: packed(getattr(record, f.name)) for f in fields(record)}


def unpacked_fields(record: Mapping) -> dict[str, Array]:
    """Return the arrays of such a record."""
    return {name: unpacked(own) for name, own in record.items()}


@dataclass(frozen=True, eq=False, slots=True)
class Reference:
    """What healthy runs of an arm have taught."""

    model: Model  # fitted to all of them, with what any arm has a little of
    rate: float  # rate of the samples [Hz]
    theta: Array  # what each joint's own fit adds to its coefficients, (dof, p)
    # Directions in which that is uncertain, one deviation each, most torque first,
    # (dof, p, u).
    basis: Array
    # Size of friction, of dry one and of speed on healthy rows [N m, 1, rad/s], that
    # coefficients are told by, (dof, 3).
    friction: Array
    usual: Usual  # noise, unrest and priors
    # Limit of each quantity [nats]: load, then friction, bias, gain of each joint,
    # (h,).
    limits: Array
    tails: tuple[Tail, ...]  # how the evidence of healthy runs decays, by quantity
    per_hour: float  # false alarms wanted at most [1/h]
    hours: float  # length of the healthy runs [h]
    # Range of q, qd, qdd in the healthy runs, (3, dof) each.
    lowest: Array
    highest: Array
    rules: Watching = field(default_factory=Watching)  # lengths of windows and the like

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.model.robot.dof

    @property
    def window(self) -> Window:
        """How samples become rows."""
        return Window(self.rate)

    @property
    def watched(self) -> tuple[tuple[str, int], ...]:
        """Each quantity and its joint from 1, in the order of ``limits``."""
        local = [(name, j + 1) for name in KINDS for j in range(self.dof)]
        return ((LOAD, self.dof), *local)

    def is_slow(self, rows: Rows) -> Array:
        """Where a joint is too slow for its friction to be trusted. Shape (m, dof)."""
        return np.abs(rows.qd) < MONITOR.slow * self.model.speed_floor

    def outside(self, rows: Rows) -> Array:
        """Where a joint is faster, or at another place, than in any healthy run.

        What the model is worth there nobody knows. Shape (m, dof), bool.
        """
        return beyond(rows, self.lowest, self.highest, MONITOR.room)

    def columns(self, rows: Rows, use: Array) -> Array:
        """Return the columns of rows (``epochs.window.products``). Shape (m, dof, f).

        Args:
            use: Where a joint counts; its columns are 0 elsewhere. Shape (m, dof).
        """
        made, theta = columns_of(self.model, rows), self.theta
        expected = made.expected + np.einsum("mjp,jp->mj", made.x, theta)
        braking = np.einsum("mjp,jp->mj", made.x, made.braking * (made.base + theta))
        parts = [
            (rows.tau - expected)[..., None],
            np.einsum("mjp,jpu->mju", made.x, self.basis),
            braking[..., None],
            np.ones((*expected.shape, 1)),
            made.body,
            expected[..., None],
            made.sign[..., None],
            rows.qd[..., None],
        ]
        return np.concatenate(parts, axis=2) * use[..., None]

    def to_record(self) -> dict:
        """Return it whole, as JSON can hold it."""
        return {
            "form": FORM,
            "model": self.model.to_record(),
            "usual": packed_fields(self.usual),
            "rules": asdict(self.rules),
            **{name: getattr(self, name) for name in _PLAIN},
            **{name: packed(getattr(self, name)) for name in _ARRAYS},
            "tails": [[t.threshold, t.beta, t.share] for t in self.tails],
        }

    @classmethod
    def from_record(cls, record: Mapping) -> "Reference":
        """Return the reference of a record."""
        if record.get("form") != FORM:
            raise InputError(
                f"A reference of form {shown(record.get('form'))}, expected {FORM}. "
                "Learn it again from healthy runs."
            )
        try:
            rules = record["rules"].items()
            rules = {k: tuple(v) if isinstance(v, list) else v for k, v in rules}
            return cls(
                model=Model.from_record(record["model"]),
                usual=Usual(**unpacked_fields(record["usual"])),
                rules=Watching(**rules),
                tails=tuple(Tail(*values) for values in record["tails"]),
                **{name: record[name] for name in _PLAIN},
                **{name: unpacked(record[name]) for name in _ARRAYS},
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"The reference is damaged: {error}.") from error


@dataclass(frozen=True, eq=False, slots=True)
class RowColumns:
    """What a model makes of rows."""

    x: Array  # torque per coefficient: inertial, then each term's, (m, dof, p)
    base: Array  # the coefficients, (p,)
    braking: Array  # which of them are friction, 1 or 0, (p,)
    expected: Array  # torque of the model [N m], (m, dof)
    body: Array  # torque per mass and first moments of a load, (m, dof, 4)
    sign: Array  # direction of motion, (m, dof)


def columns_of(model: Model, rows: Rows) -> RowColumns:
    """Return torque per coefficient, each row by itself."""
    still = np.zeros(len(rows.t))
    state = model.state(1.0, still, (rows.q, rows.qd, rows.qdd))
    x, base, size = (
        torque_columns(model, state),
        model.coefficients(),
        len(model.inertial),
    )
    braking = np.zeros(len(base))
    for term, own in with_slots(model.terms, size):
        braking[own] = term.effect.brakes
    body = x[..., size - 10 : size - 10 + BODY]
    return RowColumns(x, base, braking, x @ base, body, state.sign)


def body_sd(robot: Robot) -> Array:
    """Prior deviation of the mass and the first moments of a load. Shape (4,)."""
    (load,) = (
        effect
        for effect in registry().values()
        if effect.scope == "flange" and effect.carries == "body"
    )
    return load.prior_sd(robot)[:BODY]
