"""What changed of an arm between two epochs: one regression of the rows of both."""
