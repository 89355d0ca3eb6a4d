"""Early warning of sensors that fail."""
