"""From what happened to what a robot logs: slower, rounded, noisy."""

from residual.recording import Recording
from residual.robot.robot import Robot
from sim.catalogue import acting
from sim.plant import tables as at
from sim.plant.signal_faults import hold_frozen
from sim.plant.stepping import Trace
from sim.records import Noise, PlantEffect, Rates, Reference
from sim.streams import stream
from sim.synthetic.sensors import WHITE_TORQUE, encoder, reported, torque_noise
from sim.synthetic.sizes import sizes


def log_of(
    robot: Robot,
    trace: Trace,
    reference: Reference,
    effects: tuple[PlantEffect, ...],
    noise: tuple[Noise, int, str, float],
    rates: Rates,
) -> Recording:
    """Return the log.

    Args:
        effects: Effects of the arm; some sit in the reports of the drives.
        noise: Sizes, seed of the arm, label of the motion, and start of the log on the
            clock of the session [s].

    Returns:
        Encoder positions, reported torque and reference at the rate of the log.
    """
    sizes_, seed, label, start = noise
    every = every_nth(rates)
    t = trace.t[::every]
    q = trace.rows[::every, at.READING]
    if sizes_.encoder > 0:
        q = encoder(q, stream(seed, f"encoder/{label}"), sizes_.encoder)
    hidden = acting(effects)
    q = hold_frozen(q, t, hidden)
    tau = reported(trace.rows[:, at.DRIVE], trace.t, hidden)[::every]
    span = sizes(robot).torque * (sizes_.torque / WHITE_TORQUE)
    rng = stream(seed, f"torque/{label}")
    tau = tau + torque_noise(len(t), span, rates.log, rng)
    return Recording("", robot.name, start + t, q, tau, q_ref=reference.q[::every])


def every_nth(rates: Rates) -> int:
    """Return how many control steps make one sample of the log."""
    return round(rates.control / rates.log)
