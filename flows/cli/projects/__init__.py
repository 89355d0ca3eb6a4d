"""Commands of a project of one's own."""
