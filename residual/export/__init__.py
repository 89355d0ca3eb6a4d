"""Export of a model to other programs, with the effects that each cannot represent."""
