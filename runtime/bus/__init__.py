"""The bus between processes: what is asked of it, over zenoh, within one process, and what stands on it."""
