"""The steps behind the commands, one file per verb: a request in, a result out."""
