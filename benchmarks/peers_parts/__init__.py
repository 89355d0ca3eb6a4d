"""Parts of benchmarks/peers.py: each program reads an exported study and no more."""
