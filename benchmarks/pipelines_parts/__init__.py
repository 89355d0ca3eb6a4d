"""Parts of the benchmark of schedules, flows and clusters."""
