"""The Python API: `modelgap.py` loads each of its names on first use."""
