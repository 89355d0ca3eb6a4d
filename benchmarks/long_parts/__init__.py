"""Parts of benchmarks/long.py."""
