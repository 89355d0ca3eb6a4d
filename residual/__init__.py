"""The core: from recordings to a verdict; `diagnosis/diagnose.py` is the method."""
