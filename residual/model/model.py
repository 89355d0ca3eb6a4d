"""The model type, of which nominal, identified and augmented are instances."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio

from residual.effects import load_effects
from residual.effects.base import Effect, EffectTrait, Joints, PlacedEffect, Shape, State
from residual.errors import InputError, check_name, quote_value
from residual.recording import Array, Recording
from residual.robot.dynamics import LazyRegressor, replace_inertial_parameters
from residual.robot.robot import Robot, build_robot
from residual.signals.track import (
    SMOOTH,
    FilterSettings,
    StandstillFriction,
    Track,
    build_tracks,
    compute_friction_directions,
    interpolate_torque,
)


@dataclass(frozen=True, eq=False, slots=True)
class Term:
    """One effect on given joints with its coefficients.

    Attributes:
        effect: The effect.
        joints: Its joints, from 0.
        shape: Its nonlinear parameters.
        theta: Coefficients of its columns. Shape (k,).
        nominal: The same effect in the nominal model; None if it has none.
    """

    effect: Effect
    joints: Joints
    shape: Shape
    theta: Array
    nominal: "Term | None" = None

    def as_nominal(self) -> "Term":
        """The term as part of a nominal model, which an edit restores."""
        return replace(self, nominal=replace(self, nominal=None))

    def torque(self, state: State) -> Array:
        """Torque of this effect on all joints [N m]. Shape (n, dof)."""
        out = np.zeros(state.q.shape)
        self.add_to(out, state)
        return out

    def add_to(self, torque: Array, state: State) -> None:
        """Add the torque of this effect to that of others [N m]. Shape (n, dof)."""
        columns = self.effect.columns(state, self.joints, self.shape)
        for row, j in enumerate(self.effect.rows(self.joints, torque.shape[1])):
            torque[:, j] += columns[:, row] @ self.theta

    def regressor(self, state: State) -> Array:
        """Columns of this effect on all joints. Shape (n, dof, k)."""
        return PlacedEffect(self.effect, self.joints, self.shape).regressor(state)

    def parameters(self, robot: Robot) -> dict[str, float]:
        """Physical parameters by key, in the units of the effect."""
        values = self.effect.values(self.theta, self.shape, robot)
        return dict(zip(self.effect.parameters, map(float, values), strict=True))

    def to_record(self) -> dict:
        """The term as plain values; joints from 1."""
        nominal = self.nominal
        before = {} if nominal is None else {"nominal": nominal._values()}
        joints = [j + 1 for j in self.joints]
        return {"name": self.effect.name, "joints": joints, **self._values(), **before}

    def _values(self) -> dict:
        return {"shape": [float(x) for x in self.shape], "theta": self.theta.tolist()}

    @classmethod
    def from_record(cls, record: Mapping) -> "Term":
        """The way back."""
        effect = load_effects()[check_name(record["name"], load_effects(), "effect")]
        joints = tuple(j - 1 for j in record["joints"])
        nominal = record.get("nominal")

        def read(values: Mapping, before: Term | None = None) -> Term:
            shape, theta = tuple(values["shape"]), np.array(values["theta"])
            return cls(effect, joints, shape, theta, before)

        return read(record, None if nominal is None else read(nominal))


def pair_coefficient_slices(terms: Iterable[Term], start: int) -> Iterator[tuple[Term, slice]]:
    """Terms with the slices of their coefficients, after ``start`` inertial ones."""
    for term in terms:
        stop = start + len(term.theta)
        yield term, slice(start, stop)
        start = stop


def _terms_of(terms: Sequence[Term], name: str, joints: Sequence[int] | None) -> list[Term]:
    names = dict.fromkeys(t.effect.name for t in terms)
    check_name(name, names, "effect of this model")
    matching = [t for t in terms if t.effect.name == name]
    if joints is not None:
        matching = [t for t in matching if {j + 1 for j in t.joints} <= set(joints)]
    if not matching:
        has = sorted({j + 1 for t in terms if t.effect.name == name for j in t.joints})
        raise InputError(f"The model has no {name} on joints {list(joints or ())}, but on {has}.")
    return matching


FORM = 1  # of a model's record; raised when it changes
LEAST_SPEED = 1e-3  # rad/s: default threshold of standstill


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Model:
    """Rigid body plus effects.

    Attributes:
        robot: The arm.
        inertial: Inertial parameters, Pinocchio's order [SI]. Shape (10 dof,).
        terms: Effects with their coefficients.
        speed_floor: Speed under which a joint counts as standing [rad/s]. (dof,).
        standstill: Behaviour at standstill of each joint (`StandstillFriction`).
        clock: Start of the session on the logs' clock [s]; None where each log
            starts its own.
        filters: Signal path used to identify it.
        tables: Unnamed torque that depends on the state of each joint.
    """

    robot: Robot
    inertial: Array
    terms: tuple[Term, ...] = ()
    speed_floor: Array | None = None
    standstill: tuple[StandstillFriction, ...] = ()
    clock: float | None = None
    filters: FilterSettings = field(default_factory=FilterSettings)
    tables: tuple[Term, ...] = ()

    def __repr__(self) -> str:
        places: dict[str, list[int]] = {}
        for term in self.terms:
            places.setdefault(term.effect.name, []).extend(j + 1 for j in term.joints)
        every = set(range(1, 1 + self.robot.dof))
        named = [
            name if set(on) == every else " ".join([name, *(f"J{j}" for j in on)])
            for name, on in places.items()
        ]
        return f"Model({self.robot.name}: {', '.join(['rigid body', *named])})"

    def predict(self, recording: Recording) -> Array:
        """Torque of the model on a recorded motion, at its own samples.

        Kinematics are zero-phase filtered; the torque itself is not filtered.

        Args:
            recording: A log of the same robot.

        Returns:
            Joint torque [N m]. Shape (n, dof).
        """
        (track,), _ = build_tracks([recording], self.filters, self.speed_floor, True)
        return interpolate_torque(self.torque_on(track), track, recording)

    @property
    def theta(self) -> Array:
        """All linear parameters [SI]: inertial, then each term's. Shape (p,)."""
        return self.coefficients()

    def regressor(self, recording: Recording) -> Array:
        """Torque per parameter on a recorded motion: ``predict`` is it times theta.

        Unnamed torque (tables) is not a parameter, and is not included.

        Returns:
            [N m per SI unit of theta]. Shape (n, dof, p).
        """
        (track,), _ = build_tracks([recording], self.filters, self.speed_floor, True)
        columns = compute_torque_columns(self, self.observe(track))
        flat = columns.reshape(len(track.t), -1)
        n, dof = len(recording.t), self.robot.dof
        return interpolate_torque(flat, track, recording).reshape(n, dof, -1)

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torque at independent single states.

        Friction follows the sign of velocity, without standstill behaviour.

        Args:
            q: Positions [rad]. Shape (n, dof); (dof,) is one state.
            qd: Velocities [rad/s]. Shape (n, dof).
            qdd: Accelerations [rad/s^2]. Shape (n, dof).

        Returns:
            Joint torque [N m]. Shape (n, dof).

        Raises:
            InputError: On another shape, or where an effect depends on more than the
                state, such as a delay.
        """
        motion = [np.atleast_2d(np.asarray(x, float)) for x in (q, qd, qdd)]
        shape = (len(motion[0]), self.robot.dof)
        if any(x.shape != shape for x in motion):
            raise InputError(
                f"q, qd and qdd have shapes {', '.join(str(x.shape) for x in motion)}, "
                f"expected {shape} each: a row per state, a column per joint."
            )
        late = [t.effect for t in self.terms]
        along_log = EffectTrait.MEMORY | EffectTrait.NEEDS_CLOCK
        names = [e.name for e in late if e.traits & along_log]
        if names:
            raise InputError(
                f"The torque of {', '.join(dict.fromkeys(names))} depends on more than "
                "the state. Use predict(recording), or leave it out: "
                f"model.without('{names[0]}')."
            )
        still = self.replace_bristles_by_sign()
        return still.torque_of_state(still.state(1.0, np.zeros(shape[0]), motion))

    def pin(self) -> pinocchio.Model:
        """Return the rigid body as a Pinocchio model, with the inertias of this model.

        It has no effects: their torque is ``torque`` less Pinocchio's ``rnea``.
        """
        return replace_inertial_parameters(self.robot.model, self.inertial)

    def along(self, t: Array, motion: Sequence[Array]) -> Array:
        """Torque along a known motion, including effects with memory [N m]. (n, dof).

        Args:
            t: Session time, evenly spaced [s]. Shape (n,), n > 1.
            motion: q, qd and qdd in SI units; nothing is filtered. Shapes (n, dof).
        """
        return self.torque_of_state(self.state((len(t) - 1) / np.ptp(t), t, motion))

    def replace_bristles_by_sign(self) -> "Model":
        """Return the model with the sign of velocity in place of bristle states."""
        shapes = [replace(s, size=0.0) if s.kind == "bristle" else s for s in self.standstill]
        return replace(self, standstill=tuple(shapes), speed_floor=self._floor())

    def _floor(self) -> Array:
        floor = self.speed_floor
        return np.full(self.robot.dof, LEAST_SPEED) if floor is None else floor

    def observe(self, track: Track) -> State:
        """Inputs of effects on one log, with this model's torque."""
        t = track.t - (track.t[0] if self.clock is None else self.clock)
        motion = track.q, track.qd, track.qdd
        return self.state(track.rate, t, motion, track.enabled)

    def state(
        self, rate: float, t: Array, motion: Sequence[Array], enabled: Array | None = None
    ) -> State:
        """Inputs of effects on a known motion, with this model's torque.

        Args:
            rate: Sample rate [Hz].
            t: Session time [s]. Shape (n,).
            motion: q, qd and qdd in SI units. Shapes (n, dof).
            enabled: Share of a drive that is on; None for on. Shape (n, dof).
        """
        q, qd, qdd = motion
        regressor = LazyRegressor(self.robot, (q, qd, qdd))
        rigid = regressor @ self.inertial
        state = State(
            robot=self.robot,
            rate=rate,
            t=t,
            q=q,
            qd=qd,
            qdd=qdd,
            sign=np.zeros(q.shape),
            regressor=regressor,
            rigid=rigid,
            tau_model=rigid,
            inertial=self.loaded(),
            drive=self.drive(),
            enabled=enabled,
        )
        standstill = self.standstill or (SMOOTH,) * self.robot.dof
        return self.replace_standstill(state, standstill)

    def replace_standstill(self, state: State, standstill: Sequence[StandstillFriction]) -> State:
        """Return the state with another behaviour at standstill, of every joint."""
        motion = state.q, state.qd, self._floor()
        return self.replace_sign(state, compute_friction_directions(*motion, tuple(standstill)))

    def replace_sign(self, state: State, sign: Array) -> State:
        """Return the state with another direction of friction. Shape (n, dof)."""
        state = replace(state, sign=sign)
        return replace(state, tau_model=self.torque_seen(state, as_reported=False))

    def torque_on(self, track: Track) -> Array:
        """Torque at the samples of a log's signals [N m]. Shape (n, dof)."""
        return self.torque_seen(self.observe(track))

    def torque_seen(self, state: State, as_reported: bool = True) -> Array:
        """Torque at the samples of a state computed by this model. (n, dof)."""
        out = state.rigid.copy()
        for term in (*self.terms, *self.tables):
            if as_reported or EffectTrait.REPORT not in term.effect.traits:
                term.add_to(out, state)
        return out

    def torque_of_state(self, state: State) -> Array:
        """Torque at the samples of a state of any model [N m]. Shape (n, dof)."""
        out = state.regressor @ self.inertial
        for term in (*self.terms, *self.tables):
            term.add_to(out, state)
        return out

    def loaded(self) -> Array:
        """Inertial parameters with the loads that the terms add. Shape (10 dof,)."""
        out = self.inertial.copy()
        for term in self.terms:
            if term.effect.carries == "body":
                out[-len(term.theta) :] += term.theta
        return out

    def drive(self) -> Array:
        """Torque of the drives per speed and per acceleration. Shape (2, dof)."""
        out = np.zeros((2, self.robot.dof))
        for row, carried in enumerate(("speed", "acceleration")):
            for term in self.terms:
                if term.effect.carries == carried:
                    out[row, list(term.joints)] += term.theta
        return out

    def coefficients(self) -> Array:
        """All linear parameters: inertial, then each term's. Shape (p,)."""
        return np.concatenate([self.inertial, *(t.theta for t in self.terms)])

    def with_coefficients(self, values: Array) -> "Model":
        """The same structure with other linear parameters. Shape (p,)."""
        size = len(self.inertial)
        placed = pair_coefficient_slices(self.terms, size)
        terms = tuple(replace(term, theta=values[part]) for term, part in placed)
        return replace(self, inertial=values[:size], terms=terms)

    def without(self, name: str, joints: Sequence[int] | None = None) -> "Model":
        """Return the model without an effect; nothing is refitted.

        A finding is removed; an effect of the nominal model returns to its nominal
        value, and is removed if that is zero.

        Args:
            joints: Joints from 1 to remove it from; None for all.

        Raises:
            InputError: If the model does not have it there.
            UnknownNameError: If no term has that name.
        """
        out, terms = set(_terms_of(self.terms, name, joints)), []
        for term in self.terms:
            if term not in out:
                terms.append(term)
            elif term.nominal is not None and term.nominal.theta.any():
                terms.append(term.nominal.as_nominal())
        return replace(self, terms=tuple(terms))

    def with_parameters(
        self, name: str, joints: Sequence[int] | None = None, **values: float
    ) -> "Model":
        """Return the model with other values of an effect's physical parameters.

        A value is the total, also if a finding changed the nominal value.

        Args:
            joints: Joints from 1 on which to change it; None for all.
            values: New value of each parameter to change, in its SI unit.

        Raises:
            InputError: If the model does not have the effect there.
            UnknownNameError: If it has no such parameter.
        """
        terms = _terms_of(self.terms, name, joints)
        for key in values:
            check_name(key, terms[0].effect.parameters, f"parameter of {name}")
        changed: dict[Term, Term] = {}
        for on in dict.fromkeys(term.joints for term in terms):
            # A nominal value and its change on the same joints are merged.
            first, *more = (term for term in terms if term.joints == on)
            alike = [t.theta for t in (first, *more) if t.shape == first.shape]
            both = replace(first, theta=np.sum(alike, axis=0))
            parameters = both.parameters(self.robot) | values
            numbers = np.array([float(parameters[k]) for k in first.effect.parameters])
            theta, shape = first.effect.from_values(numbers, self.robot)
            theta = np.asarray(theta, dtype=float)
            changed[first] = replace(first, theta=theta, shape=tuple(shape))
        gone = set(terms) - set(changed)
        kept = tuple(changed.get(t, t) for t in self.terms if t not in gone)
        return replace(self, terms=kept)

    def to_record(self) -> dict:
        """The complete model as plain values, readable without other files."""
        floor = self.speed_floor
        robot = {k: getattr(self.robot, k) for k in ("name", "urdf", "toml")}
        if self.robot.locked:
            robot["locked"] = dict(self.robot.locked)
        return {
            "form": FORM,
            "robot": robot,
            "inertial": self.inertial.tolist(),
            "terms": [t.to_record() for t in self.terms],
            "background": [t.to_record() for t in self.tables],
            "speed_floor": None if floor is None else floor.tolist(),
            "standstill": [asdict(s) for s in self.standstill],
            "clock": self.clock,
            "filters": asdict(self.filters),
        }

    @classmethod
    def from_record(cls, record: Mapping) -> "Model":
        """The model of a valid record (`model_from_record`), with identical predictions.

        Raises:
            InputError: If it is of another form.
        """
        if record.get("form") != FORM:
            form = quote_value(record.get("form"))
            raise InputError(f"A model of form {form}, expected {FORM}: write it again.")
        floor = record["speed_floor"]
        return cls(
            robot=_robot_of(record["robot"]),
            inertial=np.array(record["inertial"]),
            terms=tuple(map(Term.from_record, record["terms"])),
            speed_floor=None if floor is None else np.array(floor),
            standstill=tuple(StandstillFriction(**s) for s in record["standstill"]),
            clock=record["clock"],
            filters=FilterSettings(**record["filters"]),
            tables=tuple(map(Term.from_record, record["background"])),
        )

    def save(self, path: str | Path) -> None:
        """Write the model into a JSON file, which ``load_model`` reads."""
        Path(path).write_text(json.dumps(self.to_record(), allow_nan=False) + "\n")


def _robot_of(record: Mapping) -> Robot:
    parts = dict(record)
    locked = {name: float(at) for name, at in dict(parts.pop("locked", {})).items()}
    robot = build_robot(**parts)
    return replace(robot, locked=locked) if locked else robot


def compute_torque_columns(model: Model, state: State) -> Array:
    """Torque per parameter at the samples of a state. Shape (n, dof, p)."""
    parts = (term.regressor(state) for term in model.terms)
    return np.concatenate([np.asarray(state.regressor), *parts], axis=2)
