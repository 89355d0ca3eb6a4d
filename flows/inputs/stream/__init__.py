"""Samples that are still coming: a file that grows, a folder that fills, a socket."""
