"""Logs of arms whose motion is given and whose torque follows: cheap, many."""
