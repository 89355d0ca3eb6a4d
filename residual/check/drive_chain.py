"""Torque that follows from a goal: a drive's chain, and commands logged as measurements.

The chain from goal to torque of a drive is searched with a free refit.

An arm without torque sensors has the torque of its drives (`residual.drive`), which
depends on their chain. With a wrong chain, bodies, friction and offset cannot explain the
torque: each joint's torque, in units of its gain, is refitted on the inertial regressor,
the rotor, friction while the drive is on and off, and a constant, and the chain with the
least residual is chosen. Rows at the limit are not fitted but count, so that a limit
cannot win by leaving out rows; rows at rest count too, since a goal that has already
changed would move the joint. The gain of each part of the chain over the one of the map
is stated in nats, with the range of equally good values.

The gain follows last, from the torque of the bodies in the robot file with their known
load: it is as accurate as their masses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pinocchio as pin

from residual.check.evidence import compute_row_rms
from residual.check.result import Fault, Repair, list_true_joints
from residual.check.thresholds import CHECK
from residual.drive import FACTOR, IDEAL, Drive, compute_drive_torque, limit_goal
from residual.errors import format_joint_numbers, join_with_commas
from residual.recording import Array, Recording, apply_drive
from residual.robot.dynamics import (
    PER_LINK,
    compute_inertial_regressor,
    find_flange_placement,
    read_inertial_parameters,
)
from residual.robot.robot import Robot
from residual.signals.splitting import pick_spread_pieces
from residual.signals.track import (
    FilterSettings,
    Track,
    build_tracks,
    filter_motion,
    filter_torque,
    interpolate_signals,
)

_SECONDS = 120.0  # largest length of logs used
_RIDGE = 1e-3  # of a column's power: directions without torque stay at zero
_APART = 0.1  # s: rows closer together count as one: memory of the filter
_SHARP = 0.25  # of the speed floor, over which dry friction reverses
_FEWEST = 20  # rows of a joint
# Search grids of each part: of the joint's speed; s; of the largest distance of goal and
# position. Then refined around the best.
_GRIDS = {
    "goal_speed": np.geomspace(0.3, 3.0, 24),
    "delay": np.arange(0.0, 0.16, 0.01),
    "limit": np.geomspace(0.03, 1.0, 24),
}
_FINER = {"goal_speed": 0.025, "delay": 0.0025, "limit": 0.04}
_SHIFTS = np.array([-0.01, 0.0, 0.01])  # s: of the delay, with each other value
# Values that are the same: relative, the delay in seconds.
_ALIKE = {"goal_speed": 0.1, "delay": 0.015, "limit": 0.25, "gain": 0.1}
_UNSURE = 0.1  # relative error from which a gain is not reported
# Columns: torque of the file, rotor, friction twice, dry and of the load, a constant.
_LOCAL, _BRAKES = 7, slice(2, 6)
Chain = Mapping[str, Array]  # parts by name, (dof,); limits in units of the gain [rad]
_WORDS = {
    "goal_speed": ("the goal's speed is", "rad/s"),
    "delay": ("its delay is", "s"),
    "limit": ("the limit of torque is", "N m"),
}


@dataclass(frozen=True, eq=False, slots=True)
class ChainRows:
    """Rows of all logs and joints on which chains are compared."""

    logs: tuple[Recording, ...]
    tracks: tuple[Track, ...]
    columns: tuple[Array, ...]  # of each joint, the torque of the file first, (m, k)
    use: Array  # which rows of the logs are used. Shape (n,), bool
    spread: float  # independent rows per row

    def score(self, chain: Chain) -> Array:
        """Return the log evidence of one chain on every joint, up to a constant.

        Args:
            chain: Parts by name, for each joint; the limit in units of the gain [rad].

        Returns:
            Shape (dof,) [nats].
        """
        out = np.full(len(self.columns), -np.inf)
        for j, (columns, y, clipped) in enumerate(self._rows_of(chain)):
            if (~clipped).sum() >= _FEWEST:
                left = _refit(columns, y, ~clipped)[1] / (compute_row_rms(y) + 1e-12)
                out[j] = -self.spread * len(y) * np.log(left + 1e-9)
        return out

    def limit_goals(self, speed: Array) -> "ChainRows":
        """Return the rows with goals limited to a speed, applied once."""
        drive = Drive(goal_speed=tuple(map(float, speed)))
        logs = (replace(r, q_ref=limit_goal(drive, r.q_ref, r.t)) for r in self.logs)
        return replace(self, logs=tuple(logs))

    def _rows_of(self, chain: Chain) -> list[tuple]:
        """Columns, torque over gain [rad] and rows at the limit of every joint."""
        drive = Drive(**_as_parts(chain))
        torques, clipped = [], []
        for log, track in zip(self.logs, self.tracks, strict=True):
            driven = log.q_ref, log.q, log.t, log.enabled
            torque = compute_drive_torque(drive, *driven)
            tau, masked = filter_torque(log.t, *torque, track)
            torques.append(tau)
            clipped.append(masked)
        tau, at_limit = np.concatenate(torques), np.concatenate(clipped)
        return [
            (columns, tau[self.use, j], at_limit[self.use, j])
            for j, columns in enumerate(self.columns)
        ]

    def estimate_gains(self, chain: Chain) -> tuple[Array, Array]:
        """Return each joint's gain [N m/rad] from the file's bodies, and its relative sd."""
        gains, errors = np.ones((2, len(self.columns)))
        for j, (columns, y, clipped) in enumerate(self._rows_of(chain)):
            x = columns[:, :_LOCAL]
            rows = (~clipped).sum() * self.spread
            if rows <= _LOCAL or not x[~clipped, 0].any():
                errors[j] = np.inf
                continue
            theta, noise = _refit(x, y, ~clipped, 1e-9)
            size = compute_row_rms(x) + 1e-12
            inverse = np.linalg.pinv((x / size)[~clipped].T @ (x / size)[~clipped])
            sd = noise * np.sqrt(inverse[0, 0] / self.spread) / size[0]
            errors[j] = sd / max(theta[0], 1e-12)
            gains[j] = 1 / max(theta[0], 1e-12)
        return gains, errors


def _refit(columns: Array, y: Array, kept: Array, ridge: float = _RIDGE) -> tuple[Array, float]:
    """Fit the kept rows; return the coefficients, and the rms residual of all rows."""
    size = compute_row_rms(columns[kept]) + 1e-12
    x = columns / size
    gram = x[kept].T @ x[kept] + ridge * kept.sum() * np.eye(x.shape[1])
    target, free = x[kept].T @ y[kept], np.ones(x.shape[1], bool)
    theta = np.linalg.solve(gram, target)
    while (theta[_BRAKES] < 0).any():  # no friction pushes
        free[_BRAKES] &= theta[_BRAKES] >= 0
        theta = np.zeros(len(free))
        theta[free] = np.linalg.solve(gram[np.ix_(free, free)], target[free])
    return theta / size, float(compute_row_rms(y - x @ theta))


def _as_parts(chain: Chain) -> dict[str, tuple[float, ...]]:
    return {name: tuple(map(float, values)) for name, values in chain.items()}


def build_chain_rows(robot: Robot, logs: Sequence[Recording]) -> ChainRows | None:
    """Return the rows of logs of an arm with drives; None if nothing moves."""
    logs = tuple(pick_spread_pieces(logs, _SECONDS, _SECONDS))
    tracks, floor = build_tracks([replace(r, masked=None) for r in logs], FilterSettings())
    parameters = _known_parameters(robot)
    parts: list[list[Array]] = [[] for _ in range(robot.dof)]
    for track in tracks:
        motion = track.q, track.qd, track.qdd
        regressor = compute_inertial_regressor(robot.model, *motion)
        nominal = regressor @ parameters
        on = np.ones_like(track.qd) if track.enabled is None else track.enabled
        dry = np.tanh(track.qd / (_SHARP * floor))
        for j, own in enumerate(parts):
            speed = track.qd[:, j]
            local = [nominal[:, j], track.qdd[:, j], speed * on[:, j], speed, dry[:, j]]
            local += [dry[:, j] * np.abs(nominal[:, j]), np.ones_like(speed)]
            columns = [*local, *regressor[:, j, PER_LINK * j :].T]
            own.append(track.filter(np.column_stack(columns)))
    if sum(track.moving.sum(axis=0) for track in tracks).max() < _FEWEST:
        return None
    use = np.concatenate([track.valid for track in tracks])
    step = np.median([track.step / track.rate for track in tracks])
    columns = tuple(np.concatenate(own)[use] for own in parts)
    spread = min(1.0, float(step) / _APART)
    return ChainRows(logs, tracks, columns, use, spread)


def _known_parameters(robot: Robot) -> Array:
    """Inertial parameters of the file, with the known load [SI]. (10 dof,)."""
    out = read_inertial_parameters(robot.model)
    mass = robot.known_values.get("payload.mass", 0.0)
    if mass:
        com = [robot.known_values.get(f"payload.com_{axis}", 0.0) for axis in "xyz"]
        place = find_flange_placement(robot.model).act(np.array(com))
        load = pin.Inertia(mass, place, np.zeros((3, 3)))
        out[-PER_LINK:] += load.toDynamicParameters()
    return out


def search_drive_chain(rows: ChainRows, first: Chain) -> tuple[Chain, Chain, Chain]:
    """Return the chain with the least residual of every joint, and the gain of its parts.

    Joints are independent, so each value is tried on all of them at once. Goal speed is
    searched first, without a limit, which could imitate it; then all parts together.

    Args:
        first: The chain of the map. Shapes (dof,); limits in units of the gain.

    Returns:
        Values, shapes (dof,); their gain over the map's [nats], the same; and the
        smallest and the largest equally good value, shapes (2, dof).
    """
    dof = len(rows.columns)
    speed = np.max([np.quantile(np.abs(t.qd), 0.99, axis=0) for t in rows.tracks], 0)
    distance = [np.abs(r.q_ref - r.q).max(axis=0) for r in rows.logs]
    unit = {"goal_speed": speed, "delay": np.ones(dof), "limit": np.max(distance, 0)}
    grids = {
        name: np.array([first[name], np.full(dof, IDEAL[name]), *np.outer(grid, unit[name])])
        for name, grid in _GRIDS.items()
    }
    chain = {name: np.full(dof, IDEAL[name]) for name in _GRIDS}
    chain, _ = _improve(rows, chain, "goal_speed", grids["goal_speed"], 6 * _SHIFTS)
    chain, free = _improve(rows, chain, "delay", grids["delay"])
    without = chain | {"goal_speed": first["goal_speed"]}
    worth = {"goal_speed": free - _try(rows, without, "delay", grids["delay"])[0].max(0)}
    # A limit imitates a speed, and a delay a limit: from the map's chain, from this
    # speed and from none, search limit and delay together, then the speed again.
    shifts, start = np.linspace(-0.04, 0.04, 9), chain
    chain, top = first, rows.score(first)
    for speed in (start["goal_speed"], np.full(dof, IDEAL["goal_speed"])):
        other = start | {"goal_speed": speed}
        other, _ = _improve(rows, other, "limit", grids["limit"], shifts)
        other, score = _improve(rows, other, "goal_speed", grids["goal_speed"], _SHIFTS)
        better, top = score > top, np.maximum(score, top)
        chain = {name: np.where(better, other[name], chain[name]) for name in chain}
    for step in (4, 2, 1, 2, 1):
        for name in _GRIDS:
            shifts = _SHIFTS * (name != "delay")
            chain, top = _improve(rows, chain, name, _near(chain, name, step), shifts)
    ranges = {}
    for name, grid in grids.items():
        tries = np.sort(
            [*grid, chain[name], *_near(chain, name, 1), *_near(chain, name, 3)], axis=0
        )
        scores, _ = _try(rows, chain, name, tries, _SHIFTS * (name != "delay"))
        ranges[name] = _find_range(tries, scores, np.maximum(top, scores.max(0)))
    for name in ("delay", "limit"):
        worth[name] = top - rows.score(chain | {name: first[name]})
    # A speed without an upper end is only a bound.
    low, high = ranges["goal_speed"]
    chain["goal_speed"] = np.where(
        np.isinf(high) & np.isfinite(chain["goal_speed"]), low, chain["goal_speed"]
    )
    return chain, worth, ranges


def _try(
    rows: ChainRows, chain: Chain, name: str, tries: Array, shifts: Array = _SHIFTS[1:2]
) -> tuple[Array, Array]:
    """Return the score of each value of a part, with the best of some delays.

    Args:
        shifts: Values of the delay [s].

    Returns:
        Scores [nats] and delays [s]. Shapes (tries, dof).
    """
    scores, delays = np.empty((2, len(tries), len(rows.columns)))
    still = {"goal_speed": np.full_like(chain["delay"], IDEAL["goal_speed"])}
    limited = rows.limit_goals(chain["goal_speed"])  # the slowest step
    for i, value in enumerate(tries):
        if name == "goal_speed":
            limited = rows.limit_goals(value)
        own = chain | {name: value} | still
        late = np.maximum(own["delay"] + np.unique(shifts)[:, None], 0.0)
        of = np.array([limited.score(own | {"delay": each}) for each in late])
        best = of.argmax(axis=0)[None]
        scores[i], delays[i] = (np.take_along_axis(x, best, 0)[0] for x in (of, late))
    return scores, delays


def _improve(
    rows: ChainRows, chain: Chain, name: str, tries: Array, shifts: Array = _SHIFTS[1:2]
) -> tuple[Chain, Array]:
    """Return the chain with the best of some values of a part, and its score."""
    tries = np.array([chain[name], *tries])
    scores, delays = _try(rows, chain, name, tries, shifts)
    best = scores.argmax(axis=0)[None]
    values, late, top = (np.take_along_axis(x, best, 0)[0] for x in (tries, delays, scores))
    return chain | {"delay": late} | {name: values}, top


def _near(chain: Chain, name: str, step: int) -> Array:
    """Return values around the one of a chain, nearer with a smaller step."""
    steps = step * _FINER[name] * np.array([[-1.0], [1.0]])
    if name == "delay":
        return np.maximum(chain[name] + steps, 0.0)
    return chain[name] * (1 + steps)


def _find_range(tries: Array, scores: Array, top: Array) -> Array:
    """Return the first and the last value as good as the best. (2, dof)."""
    out = np.empty((2, tries.shape[1]))
    for j, (values, below) in enumerate(zip(tries.T, (top - scores).T, strict=True)):
        good = np.flatnonzero(below <= CHECK.odds_nats)
        for side, (at, way) in enumerate(((good[0], -1), (good[-1], 1))):
            out[side, j] = values[at]
            if 0 <= at + way < len(values) and np.isfinite(values[[at, at + way]]).all():
                share = (CHECK.odds_nats - below[at]) / (below[at + way] - below[at])
                out[side, j] += share * (values[at + way] - values[at])
    return out


def find_drive_faults(
    robot: Robot, logs: Sequence[Recording]
) -> tuple[list[Fault], list[Recording]]:
    """Find missing or wrong parts of the chain in the map.

    Returns:
        One fault with the line that repairs it, or none; and the logs with the torque
        of the found chain.
    """
    drive = logs[0].drive
    if drive is None or any(r.drive != drive or r.q_ref is None for r in logs):
        return [], list(logs)
    rows = build_chain_rows(robot, logs)
    if rows is None:
        return [], list(logs)
    given = drive.values("gain", robot.dof)
    first = {name: drive.values(name, robot.dof) for name in _GRIDS}
    first["limit"] = first["limit"] / given
    chain, worth, ranges = search_drive_chain(rows, first)
    fall = rows.score(chain) - rows.score(first)
    halved = fall > np.log(2) * rows.spread * rows.use.sum()
    wrong = {}
    for name, values in chain.items():
        least = _ALIKE[name] * (1.0 if name == "delay" else np.minimum(values, 1e9))
        with np.errstate(invalid="ignore"):  # two infinite values are equal
            far = ~(np.abs(values - first[name]) <= least) & (values != first[name])
        wrong[name] = (worth[name] > CHECK.odds_nats) & far
        chain[name] = np.where(wrong[name], values, first[name])
    gain, error = rows.estimate_gains(chain)
    far = np.abs(np.log(gain / given)) > np.maximum(_ALIKE["gain"], 3 * error)
    # A gain of the map is compared with the file's masses, unless a load was weighed.
    asked = not drive.gain or "payload.mass" in robot.known_values
    wrong["gain"] = far & (error < _UNSURE) & asked
    gain = np.where(wrong["gain"], gain, given)
    bad = np.any(list(wrong.values()), axis=0)
    if not bad.any():
        return [], list(logs)
    chain |= {"gain": gain, "limit": chain["limit"] * gain}
    ranges |= {"limit": ranges["limit"] * gain}
    parts = {n: v for n, v in chain.items() if np.any(v != IDEAL[n])}
    found = Drive(**_as_parts(parts), enabled=drive.enabled)
    # A part missing in the map is certain if it halves the residual: another value may
    # be a change of the arm, and a smaller gain an effect.
    left_out = {n: wrong[n] & (first[n] == IDEAL[n]) & halved for n in worth}
    certain = [w[left_out[n]].sum() > CHECK.certain_nats for n, w in worth.items()]
    words = _describe(robot, wrong, worth, chain, ranges, given)
    repairs = (Repair("drive", drive=found),)
    fault = Fault("drive", list_true_joints(bad), any(certain), words, repairs)
    return [fault], [apply_drive(r, found) for r in logs]


def _describe(
    robot: Robot, wrong: Chain, worth: Chain, chain: Chain, ranges: Chain, given: Array
) -> str:
    """Return the faults of a chain in words."""
    parts = []
    for name in worth:
        joints = wrong[name]
        if joints.any():
            words, unit = _WORDS[name]
            ends = ranges[name].T[joints]
            values = join_with_commas(
                [
                    f"{v:.3g} [{low:.3g} to {high:.3g}]"
                    if np.isfinite(high)
                    else f"at least {low:.3g}"
                    for v, (low, high) in zip(chain[name][joints], ends, strict=True)
                ]
            )
            nats = worth[name][joints].sum()
            parts.append(f"{words} {values} {unit} ({nats:.0f} nats)")
    out = [f"The drive is not the one of the map: {'; '.join(parts)}."] if parts else []
    scaled = wrong["gain"]
    if scaled.any():
        known = "payload.mass" in robot.known_values
        mapped, new = (
            join_with_commas([f"{g:.3g}" for g in x[scaled]]) for x in (given, chain["gain"])
        )
        source = "the known mass" if known else "the masses of the robot file"
        out.append(f"By {source} its gain is {new} N m/rad, {mapped} in the map.")
        if not known:
            out.append(FACTOR)
    return " ".join(out)


# Computed torque, logged in place of a measured one.
#
# A command follows from the reference alone: it is the same in every repetition, to the
# last bit, and a model explains all of it. A measured torque has sensor noise and a
# residual.


_FILTERS = FilterSettings(kinematics=25.0)  # Hz: derivatives of a reference have no noise
_EDGE = 0.5  # s
_ROWS, _PER_COLUMN = 900, 4  # rows to use, and least number of rows per column
_SLOW = 0.1  # of the largest speed: nearer to a reversal friction differs


def find_commanded_torque(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find computed torque, logged in place of a measured one."""
    return _repeated(recordings) or _followed(robot, recordings)


def _repeated(recordings: Sequence[Recording]) -> list[Fault]:
    """Torques of two logs that are equal bit by bit while the angles are not."""
    rows = [tuple(set(map(bytes, x)) for x in (r.tau, r.q)) for r in recordings]
    for (one, first), (other, second) in combinations(zip(recordings, rows, strict=True), 2):
        tau, q = (len(a & b) / len(a) for a, b in zip(first, second, strict=True))
        if len(first[0]) < 50 or tau < CHECK.repeated_share or q > tau / 2:
            continue
        words = (
            f"Expected torque with the noise of a sensor, got {100 * tau:.0f} % of the "
            f"torques of {one.id} again in {other.id}, bit for bit on all joints, "
            "while the angles differ: it is a command. Log the measured torque or "
            "current (columns of tau in --map)."
        )
        return [Fault("commanded", (), True, words)]
    return []


def _followed(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Torque that a model explains by the reference alone, on all joints that move."""
    if any(r.q_ref is None for r in recordings):
        return []
    planned, torque = _signal_rows(recordings, "q_ref")
    done, _ = _signal_rows(recordings, "q")
    moves = np.max([np.ptp(r.q_ref, axis=0) for r in recordings], axis=0) > CHECK.moving_rad
    worst, nearest = 0.0, np.inf
    for j in np.flatnonzero(moves):
        speed = np.abs(planned[1, :, j])
        use = speed > _SLOW * speed.max()
        columns, tau = _command_columns(robot, int(j), planned[:, use]), torque[use, j]
        rows, count = columns.shape
        if rows < _PER_COLUMN * count:
            return []
        size, scale = float(np.std(tau)) + 1e-12, compute_row_rms(columns) + 1e-12
        at = np.linalg.lstsq(columns / scale, tau, rcond=1e-10)[0] / scale
        free = np.sqrt(rows / (rows - count))
        left = float(np.std(tau - columns @ at) * free) / size
        if not left < CHECK.command_residual:
            return []
        moved = _command_columns(robot, int(j), done[:, use]) @ at
        worst = max(worst, left)
        nearest = min(nearest, float(np.std(tau - moved)) / size)
    if not worst:
        return []
    # If the arm follows its reference well, a quiet measurement looks the same.
    certain = bool(nearest > max(CHECK.command_ratio * worst, CHECK.command_residual))
    words = (
        f"Expected torque with noise and with what no model has, got one that follows "
        f"from the reference alone to {100 * worst:.2g} % on "
        f"{format_joint_numbers(list_true_joints(moves))} (measured ones: 3 % at "
        f"best): it is a "
        "command or a feed-forward. Log the measured torque or current (columns of "
        "tau in --map)."
    )
    return [Fault("commanded", (), certain, words)]


def _signal_rows(logs: Sequence[Recording], signal: str) -> tuple[Array, Array]:
    """Angles, speeds and accelerations from a signal, (3, n, dof), and torque."""
    parts, torques = [], []
    every = max(1, sum(len(r.t) for r in logs) // _ROWS)
    for log in logs:
        t, _, motion = filter_motion(replace(log, q=getattr(log, signal)), _FILTERS)
        use = np.flatnonzero((t > t[0] + _EDGE) & (t < t[-1] - _EDGE))[::every]
        parts.append(np.stack(motion)[:, use])
        torques.append(interpolate_signals(t[use], log.t, log.tau))
    return np.concatenate(parts, axis=1), np.concatenate(torques)


def _command_columns(robot: Robot, j: int, motion: Array) -> Array:
    """Any body from this joint on, friction, a rotor and an offset. Shape (n, p)."""
    q, qd, qdd = motion
    body = compute_inertial_regressor(robot.model, q, qd, qdd)[:, j, PER_LINK * j :]
    v, a = qd[:, j], qdd[:, j]
    return np.column_stack([body, v, np.sign(v), v * np.abs(v), a, np.ones_like(v)])
