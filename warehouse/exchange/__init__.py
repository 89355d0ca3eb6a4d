"""A record with all that it was made from, to and from another machine."""
