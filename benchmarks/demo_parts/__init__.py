"""Groups of benchmarks/demo.py."""
