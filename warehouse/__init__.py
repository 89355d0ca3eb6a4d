"""The world remembered: measured logs come in here; runs and models are kept."""
