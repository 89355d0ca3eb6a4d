"""The pure core: from recordings to a verdict; `close.py` is the whole method."""
