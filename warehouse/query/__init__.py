"""The store as a database: catalogue, views, and what of SQL may run."""
