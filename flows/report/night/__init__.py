"""Pages over all of a store: a night, a robot, every report, one record."""
