"""Laser ranges in, motions and maps out: matching and DP-SLAM, as pure functions of arrays and stamps."""
