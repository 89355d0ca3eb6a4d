"""Inputs of the commands: logs, runs, robots."""
