"""The groups of benchmarks/plant.py."""
