"""Commands of the loop: what to do after a verdict."""
