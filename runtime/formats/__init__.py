"""What people have on disk: laser logs, bags, trajectories, maps."""
