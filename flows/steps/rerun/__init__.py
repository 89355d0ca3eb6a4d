"""A record made again from its request and its ancestors, and compared."""
