"""Faults of logs, column maps and robot files."""
