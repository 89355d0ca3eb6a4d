"""What a command is given: logs, runs, robots."""
