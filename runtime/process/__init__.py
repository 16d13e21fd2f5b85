"""What is around the code of every process: its port on the bus, its heartbeat, its wishes to the kernel."""
