"""Friction over days and within them: wear told from warming up."""
