"""One module a process: the only place where runtime meets drivers and processing."""
