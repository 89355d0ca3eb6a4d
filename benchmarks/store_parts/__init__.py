"""Groups of the benchmark of the store."""
