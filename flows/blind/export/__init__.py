"""The sealed study as plain files, for any other program."""
