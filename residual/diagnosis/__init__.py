"""What a model lacks: search, gate, proof, and the verdict."""
