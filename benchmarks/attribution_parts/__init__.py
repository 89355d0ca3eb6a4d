"""Groups of the benchmark of what changed."""
