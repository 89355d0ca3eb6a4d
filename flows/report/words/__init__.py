"""Results in plain sentences and in rows of tables."""
