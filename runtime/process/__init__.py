"""What is around the code of every process: its port on the bus, its heartbeat, how it is, what it asks of the kernel."""
