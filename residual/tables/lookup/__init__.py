"""A fitted correction as small tables: built, evaluated, exported."""
