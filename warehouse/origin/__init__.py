"""Which code, packages, robots and records a record was made with."""
