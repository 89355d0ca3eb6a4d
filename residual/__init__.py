"""The pure core: from recordings to a verdict; `method/diagnose.py` has it whole."""
