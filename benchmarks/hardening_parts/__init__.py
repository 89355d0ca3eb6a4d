"""Groups of benchmarks/hardening.py."""
