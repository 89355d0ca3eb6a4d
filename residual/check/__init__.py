"""Is a log what it says it is: faults of logs, column maps and robot files."""
