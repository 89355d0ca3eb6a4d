"""Every doubt that a name has to survive before it is said."""
