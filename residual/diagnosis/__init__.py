"""The effects that a model lacks: search, gate, held-out test, and the verdict."""
