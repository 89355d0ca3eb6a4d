"""The shell: plain steps, the flows over them, the command line and the report."""
