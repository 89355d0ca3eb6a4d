"""Parts of benchmarks/check.py: arms, faults put into their logs, and what counts."""
