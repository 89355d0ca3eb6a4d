"""Groups of the benchmark of the loop that closes itself."""
