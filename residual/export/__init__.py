"""A model in the form of other programs, with what each of them has no place for."""
