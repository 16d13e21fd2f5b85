"""What `hallway doctor` looks at, one module for each part of the way from the laser to the bus."""
