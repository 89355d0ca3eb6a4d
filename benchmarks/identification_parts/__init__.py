"""Groups of figures of benchmarks/identification.py."""
