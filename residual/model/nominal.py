"""Logs prepared for a fit, and the nominal model: body and effects.

Known values come from `[known]` of robot.toml and --known:
"payload.mass" = 2.8, "coulomb.2.level" = 8.0, "link.3.mass" = 4.1: a name, the joint
from 1 if the effect is of one joint, and a parameter. For a declared effect it is the
value; for a candidate it is the value if it is found. Only parameters that are linear in
the coefficients of an effect can be known: a mass, a level, a stiffness.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from residual.effects import load_effects
from residual.effects.base import Effect, EffectTrait, Joints, MotionSpan, State
from residual.errors import InputError, check_keys, check_name, join_with_commas, quote_value
from residual.model.model import Model, Term
from residual.recording import Array, Recording
from residual.robot.dynamics import PER_LINK, read_inertial_parameters
from residual.robot.robot import Robot
from residual.signals.splitting import choose_spread_pieces, split_long_logs
from residual.signals.track import (
    CHOICES,
    SMOOTH,
    FilterSettings,
    StandstillFriction,
    Track,
    add_angle_noise,
    build_tracks,
    find_unresolved_torques,
)

LINK, MASS = "link", "mass"
EXACT = 1e-3  # of the value: one standard deviation of a known value
TRIES = 3  # random draws per coefficient of an effect, to test linearity


@dataclass(frozen=True, eq=False, slots=True)
class KnownValue:
    """One value."""

    name: str  # of the effect, or "link"
    joints: Joints  # from 0; empty where the effect is of no single joint
    key: str  # its parameter
    value: float  # in its SI unit
    row: Array  # the parameter is ``row @ theta``, (k,)


@lru_cache(maxsize=8)
def list_known_values(robot: Robot) -> tuple[KnownValue, ...]:
    """Return the known values of an arm and its candidates.

    Raises:
        InputError: If a value cannot be given as known, with those that can.
        UnknownNameError: If there is no such effect or parameter.
    """
    return tuple(_read(k, v, robot) for k, v in robot.known_values.items())


def refuse_known_values_with_baseline(robot: Robot) -> None:
    """Refuse a baseline for an arm with known values.

    Raises:
        InputError: If there are any.
    """
    if robot.known_values:
        raise InputError(
            f"Known values ({join_with_commas(robot.known_values)}) belong to one "
            "state of the arm; a baseline compares two. Leave out --known, and [known] "
            "of robot.toml, or the baseline."
        )


def select_effect_values(robot: Robot, effect: Effect, joints: Joints) -> list[KnownValue]:
    """Return the known values of an effect on given joints."""
    every = [k for k in list_known_values(robot) if k.name == effect.name]
    # An effect at the flange has one place, regardless of its joint number.
    out = [k for k in every if not k.joints or k.joints == joints]
    if effect.replaces_link and joints[0] in read_known_masses(robot):
        # A link of known mass is not replaced.
        out.append(KnownValue(effect.name, joints, "", 0.0, np.ones(1)))
    return out


def read_known_masses(robot: Robot) -> dict[int, float]:
    """Return the links, from 0, whose mass is known [kg]."""
    return {k.joints[0]: k.value for k in list_known_values(robot) if k.name == LINK}


def compute_known_value_information(
    values: Sequence[KnownValue], precision: Array, change: bool
) -> tuple[Array, Array]:
    """Return the terms of known values in a typical prior: information K, and pull b.

    (P + K) is the precision of coefficients with mean (P + K)^-1 b.

    Args:
        precision: P of the typical prior. Shape (k, k).
        change: Whether theta is a change of a value of the model: then zero.

    Returns:
        Shapes (k, k), (k,).
    """
    information, pull = np.zeros(precision.shape), np.zeros(len(precision))
    for value_known in values:
        value = 0.0 if change else value_known.value
        before = value_known.row @ np.linalg.solve(precision, value_known.row)
        sd = EXACT * max(abs(value_known.value), EXACT * float(np.sqrt(before)))
        information += np.outer(value_known.row, value_known.row) / sd**2
        pull += value_known.row * value / sd**2
    return information, pull


def _read(word: str, value: float, robot: Robot) -> KnownValue:
    name, *middle, key = word.split(".") if "." in word else (word, "")
    check_name(name, (*load_effects(), LINK), "effect of a known value")
    if name == LINK:
        check_name(key, (MASS,), "parameter of a link that can be known")
        if not value > 0:
            raise InputError(f"Known {word} = {value:g}: expected a mass above 0 kg.")
        return KnownValue(name, _joint(word, middle, robot), key, value, np.ones(1))
    effect = load_effects()[name]
    rows = _rows(effect, robot)
    if not rows:
        able = ", ".join(n for n, e in load_effects().items() if _rows(e, robot))
        raise InputError(
            f"No value of {name} can be known: what its parameters do is not linear. "
            f"Expected one of link, {able}."
        )
    check_name(key, rows, f"parameter of {name} that can be known")
    if effect.scope == "local" or effect.scope == "link":
        joints = _joint(word, middle, robot)
    elif middle:
        raise InputError(f"Known {word}: {name} has no joint; write {name}.{key}.")
    else:
        joints = ()
    return KnownValue(name, joints, key, value, rows[key])


def _joint(word: str, middle: Sequence[str], robot: Robot) -> Joints:
    names, text = robot.joints, ".".join(middle)
    if text in names:
        return (names.index(text),)
    if not text.isdigit() or not 1 <= int(text) <= robot.dof:
        first, *_, last = word.split(".") if "." in word else (word, "")
        raise InputError(
            f"Known {word}: joint {quote_value(text)} expected from 1 to {robot.dof} "
            f"or a joint of the URDF ({', '.join(names)}), as in {first}.2.{last}."
        )
    return (int(text) - 1,)


def _rows(effect: Effect, robot: Robot) -> dict[str, Array]:
    """Parameters that are linear in the coefficients, as rows. Shapes (k,)."""
    if effect.refine is not None:  # the meaning of its coefficients depends on the shape
        return {}
    rng = np.random.default_rng(0)
    start = rng.uniform(1, 2, len(effect.parameters))
    theta, shape = effect.from_values(start, robot)
    some = rng.uniform(0.5, 2, (TRIES * len(theta), len(theta)))
    values = np.array([effect.values(draw, shape, robot) for draw in some])
    rows, *_ = np.linalg.lstsq(some, values, rcond=None)
    miss = np.abs(some @ rows - values).max(axis=0)
    keys = zip(effect.parameters, rows.T, miss, strict=True)
    return {key: row.round(12) for key, row, gap in keys if gap < 1e-9}


MOST_SHAPES = 4
# Default effects of a model, in the order of its coefficients.
DEFAULT_DECLARED = tuple(
    effect.name
    for effect in sorted(load_effects().values(), key=lambda e: e.drive_order)
    if effect.drive_order
)
GIVEN, ASSUMED = 0.1, 1.0  # relative sd of a declared value, and of an assumed one


@dataclass(frozen=True, eq=False, slots=True)
class NominalModel:
    """The nominal model and its prior."""

    model: Model  # the model
    # Relative sd of each term's coefficients; None if no value is given.
    sd: tuple[float | None, ...]
    # Fixed relative scale of the rigid part, None to estimate it.
    scale: float | None = None
    # Fixed relative sd of each kind of given value, by the effect's name; None to
    # estimate them.
    widths: Mapping[str, float] | None = None
    # Number of undeclared constants at the end of the model's terms: they are zero, free
    # during the search, and then candidates themselves.
    constants: int = 0

    def without_constants(self) -> "NominalModel":
        """The declared model, without added constants."""
        count = len(self.sd) - self.constants
        model = replace(self.model, terms=self.model.terms[:count])
        return replace(self, model=model, sd=self.sd[:count], constants=0)

    @property
    def declared(self) -> tuple[tuple[Term, float | None], ...]:
        """Declared terms, each with its given values."""
        return tuple(zip(self.model.terms, self.sd, strict=True))

    @property
    def kinds(self) -> dict[str, float]:
        """Prior relative sd of given values, by effect's name."""
        return {t.effect.name: g for t, g in self.declared if g is not None}

    @property
    def names(self) -> tuple[str, ...]:
        """Declared effects, each once."""
        return tuple(dict.fromkeys(t.effect.name for t, _ in self.declared))


def choose_declared_effects(robot: Robot, names: Sequence[str] | None) -> tuple[str, ...]:
    """The declared effects: the user's list, else robot.toml's, else the default three.

    Raises:
        UnknownNameError: If no effect has such a name.
    """
    chosen = (robot.declared or DEFAULT_DECLARED) if names is None else names
    for name in chosen:
        check_name(name, load_effects(), "effect")
    return tuple(dict.fromkeys(chosen))


def build_nominal(
    robot: Robot,
    names: Sequence[str],
    span: MotionSpan,
    speed_floor: Array,
    clock: float | None = None,
) -> NominalModel:
    """Build the nominal model with the robot's values where given, else zero and free.

    Raises:
        InputError: If a declared effect needs its values.
        UnknownNameError: If robot.toml gives a value that the effect does not have.
    """
    terms, widths = [], []
    for name in names:
        effect = load_effects()[name]
        declared = robot.declared.get(name)
        for joints in effect.candidates(robot.dof, robot.prismatic):
            if declared is None or not declared.values:
                free = _free(effect, joints, span, robot)
                terms += free
                widths += [None] * len(free)
            else:
                terms.append(_declared_term(effect, joints, declared.values, robot))
                widths.append(ASSUMED if declared.assumed else GIVEN)
    body = read_inertial_parameters(robot.model).reshape(-1, PER_LINK)
    for link, mass in read_known_masses(robot).items():
        body[link] *= mass / max(body[link, 0], 1e-9)
    for i, term in enumerate(terms):
        theta = term.theta.copy()
        for fixed in select_effect_values(robot, term.effect, term.joints):
            row = fixed.row
            theta += row * (fixed.value - row @ theta) / (row @ row)
        if not np.array_equal(theta, term.theta):
            terms[i] = replace(term, theta=theta).as_nominal()
    model = Model(robot, body.ravel(), tuple(terms), speed_floor, clock=clock)
    return NominalModel(model, tuple(widths), scale=robot.prior_scale)


def _declared_term(effect: Effect, joints: Joints, values, robot: Robot) -> Term:
    check_keys(values, effect.parameters, f"[declared.{effect.name}] of robot.toml")
    missing = [k for k in effect.parameters if k not in values]
    # A load may be given by its mass alone; missing values are zero.
    if missing and effect.carries != "body":
        raise InputError(
            f"[declared.{effect.name}] lacks {', '.join(missing)}. "
            f"Give all of {', '.join(effect.parameters)}, or no values at all."
        )
    anchor = joints[0] if joints else 0
    numbers = [
        float(np.asarray(values[k])[anchor]) if k in values else 0.0 for k in effect.parameters
    ]
    theta, shape = effect.from_values(np.array(numbers), robot)
    return Term(effect, joints, shape, np.asarray(theta, dtype=float)).as_nominal()


def _free(effect: Effect, joints: Joints, span: MotionSpan, robot: Robot) -> list[Term]:
    """Terms of a declared effect of unknown size, one for each of a few shapes."""
    anchor = joints[0] if joints else 0
    shapes = list(effect.shapes(span, anchor))
    if len(shapes) > 2 * MOST_SHAPES:
        raise InputError(
            f"{effect.name} is declared without values, and its shape cannot be "
            f"fitted blindly. Give {', '.join(effect.parameters)} in robot.toml."
        )
    theta, _ = effect.from_values(np.ones(len(effect.parameters)), robot)
    nothing = np.zeros(len(theta))
    return [Term(effect, joints, s, nothing).as_nominal() for s in shapes]


@dataclass(frozen=True, eq=False, slots=True)
class FitLogs:
    """Prepared fit logs: signals, session clock and range of motion.

    ``shaken`` are those of the ``sketch`` with redrawn noise of their angles.
    """

    robot: Robot
    tracks: tuple[Track, ...]
    clock: float | None
    span: MotionSpan
    speed_floor: np.ndarray
    filters: FilterSettings
    shaken: tuple[Track, ...]
    # Joints (from 0) whose torque is hardly above its quantization or noise: none of
    # their rows counts.
    too_small: tuple[int, ...] = ()

    @property
    def sketch(self) -> tuple[Track, ...]:
        """All logs; for long ones as many pieces as fit into memory."""
        shown = choose_spread_pieces([t.seconds for t in self.tracks])
        return tuple(self.tracks[i] for i in shown)


def prepare_fit_logs(
    robot: Robot,
    recordings: Sequence[Recording],
    clock: float | None,
    filters: FilterSettings,
    split_long: bool = True,
) -> FitLogs:
    """Prepare the signals of the fit logs; cut long ones if ``split_long``."""
    if split_long:
        recordings = split_long_logs(recordings, filters.torque)
    tracks, floor = build_tracks(recordings, filters)
    # By the measure of `pick_spread_pieces`: what that kept is all shown.
    shown = choose_spread_pieces([r.duration for r in recordings])
    some = [recordings[i] for i in shown]
    small = find_unresolved_torques(some, [tracks[i] for i in shown])
    # Rows of joints that log no torque, or too little, do not count.
    alive = np.any([np.any(t.tau != 0, axis=0) for t in tracks], axis=0) & ~small
    if not alive.all():
        tracks = tuple(replace(t, moving=t.moving & alive) for t in tracks)
    q = np.concatenate([t.q for t in tracks])
    qd = np.concatenate([t.qd for t in tracks])
    tau = np.concatenate([t.tau for t in tracks])
    last = max(t.t[-1] for t in tracks)
    span = MotionSpan(
        speed=np.quantile(np.abs(qd), 0.95, axis=0),
        travel=np.ptp(q, axis=0),
        duration=0.0 if clock is None else float(last - clock),
        cutoff=min(t.cutoff for t in tracks),
        torque=np.quantile(np.abs(tau), 0.995, axis=0),
        prismatic=robot.prismatic,
        switched=_find_switched_joints(tracks),
        one_drive=recordings[0].drive is not None and len({r.drive for r in recordings}) == 1,
    )
    noisier = add_angle_noise(some, [tracks[i] for i in shown], filters)
    places = tuple(np.flatnonzero(small).tolist())
    return FitLogs(robot, tracks, clock, span, floor, filters, noisier, places)


def _find_switched_joints(tracks: Sequence[Track]) -> tuple[bool, ...]:
    """Find joints whose drives are off in a part of the logs; () for none."""
    logged = [t.enabled[:: t.step][t.moving.any(axis=1)] for t in tracks if t.enabled is not None]
    if not logged:
        return ()
    on = np.concatenate(logged) > 0.5
    off = (~on).any(axis=0) & (on.any(axis=0) | (len(logged) < len(tracks)))
    return tuple(off.tolist())


def start_model(logs: FitLogs, declared: Sequence[str] | Model | None) -> Model:
    """The model to start from, on the clock and thresholds of these logs.

    Args:
        declared: Its effects, None for the robot's list; or a model, such as an adopted
            one.
    """
    if isinstance(declared, Model):
        return replace(declared, speed_floor=logs.speed_floor, clock=logs.clock)
    return build_free_nominal(logs, choose_declared_effects(logs.robot, declared)).model


def build_free_nominal(logs: FitLogs, names: Sequence[str]) -> NominalModel:
    """The user's model, on the clock and thresholds of these logs."""
    return build_nominal(logs.robot, names, logs.span, logs.speed_floor, logs.clock)


def add_joint_constants(logs: FitLogs, names: Sequence[str]) -> NominalModel:
    """Return the declared model with a constant on each joint without a declared one.

    A missing sensor offset biases all other effects: over little travel it looks like a
    spring. So each is free during the search, and then a candidate like any other.

    Args:
        names: The declared effects.
    """
    settled = {*names, *(known.name for known in list_known_values(logs.robot))}
    more = [e.name for e in load_effects().values() if EffectTrait.CONSTANT in e.traits]
    more = [name for name in more if name not in settled]
    nominal = build_free_nominal(logs, (*names, *more))
    terms = [t for t in nominal.model.terms if t.effect.name in more]
    return replace(nominal, constants=len(terms))


WORTH = 0.98  # share of the default's squared error that another choice must fall below


def choose_standstill_behaviour(model: Model, tracks: Sequence[Track]) -> Model:
    """Choose each joint's behaviour at standstill by the total error of the fit logs.

    The torque is linear in the share held at standstill, so that the best share has a
    closed form for each kind.
    """
    observed = [(track, model.observe(track)) for track in tracks]
    candidates = [_standstill_error(model, observed, shape) for shape in CHOICES]
    miss = np.array([m for m, _ in candidates])
    order = np.argmin(miss, axis=0)
    default = CHOICES.index(SMOOTH)
    chosen = []
    for j, i in enumerate(order):
        pick = int(i) if miss[i, j] < WORTH * miss[default, j] else default
        chosen.append(replace(CHOICES[pick], hold=float(candidates[pick][1][j])))
    return replace(model, standstill=tuple(chosen))


def _standstill_error(
    model: Model, observed: Sequence[tuple[Track, State]], shape: StandstillFriction
) -> tuple[Array, Array]:
    """Squared error at the best share held, and that share. Shapes (dof,), (dof,)."""
    dof = model.robot.dof
    base, mixed, power = np.zeros(dof), np.zeros(dof), np.zeros(dof)
    reads = EffectTrait.REPORT | EffectTrait.USES_MODEL
    plain = not any(t.effect.traits & reads for t in model.terms)
    for track, state in observed:
        seen = [
            model.replace_standstill(state, (side,) * dof)
            for side in (replace(shape, hold=0.0), shape)
        ]
        # Without effects that change it, the state has the full torque.
        sides = [s.tau_model if plain else model.torque_seen(s) for s in seen]
        none, full = np.split(track.filter(np.concatenate(sides, axis=1)), 2, axis=1)
        gap, step = (track.tau - none)[track.valid], (full - none)[track.valid]
        base += (gap**2).sum(axis=0)
        mixed += (gap * step).sum(axis=0)
        power += (step**2).sum(axis=0)
    share = np.clip(mixed / np.maximum(power, 1e-30), 0, 1).round(2)
    share[power <= 1e-12 * base] = 1.0
    return base - 2 * share * mixed + share**2 * power, share
