"""Numbers by which the compiled plant knows its laws (`sim.plant.friction`, `torques`).

An effect's file says which of them it makes, and with which numbers.
"""

# Rows of friction.
LEVEL, ASYMMETRY, VISCOUS, VISCOUS_ASYMMETRY, QUADRATIC, POWER = range(6)
STRIBECK, CARRIED, POSITION, WARMUP, BRISTLE = range(6, 11)
FADING, PRESSED = 11, 12  # of the background
# Rows of torque.
CONSTANT, HOSE, GAS_SPRING, RIPPLE, COGGING_SUM, WALL, SERIES, DEAD_ZONE = range(8)
WAVE = 8  # of the background
# These torques act on the motor side of an elastic transmission, the rest on the link.
AT_MOTOR = (RIPPLE, COGGING_SUM, DEAD_ZONE, WAVE)
