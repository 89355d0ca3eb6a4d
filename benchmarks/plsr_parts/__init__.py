"""Parts of the benchmark of the paper's chapter."""
