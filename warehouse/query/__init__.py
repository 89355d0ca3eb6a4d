"""The store as a database: views, named queries and the guard of user SQL."""
