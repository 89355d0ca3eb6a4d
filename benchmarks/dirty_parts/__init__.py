"""Groups of the benchmark of arms that are never clean."""
