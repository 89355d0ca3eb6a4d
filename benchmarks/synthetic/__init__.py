"""Synthetic arms: a given motion, and its torque without a simulation in time."""
