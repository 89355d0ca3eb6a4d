"""What comes back out of the programs that a model was exported to."""
