"""Many arms at once."""
