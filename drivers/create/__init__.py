"""iRobot Create over its Open Interface: teleoperation and telemetry, never odometry."""
