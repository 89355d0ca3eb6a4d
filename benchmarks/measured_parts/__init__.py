"""The groups of benchmarks/logs.py."""
