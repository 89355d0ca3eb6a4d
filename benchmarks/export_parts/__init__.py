"""Groups of figures of benchmarks/export.py."""
