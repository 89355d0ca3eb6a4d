"""The world simulated: arms that hide effects, and what their sensors log."""
