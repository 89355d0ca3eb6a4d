"""One reader per file format of measured logs."""
