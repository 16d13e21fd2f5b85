"""The processes of a robot: started, watched, started again, stopped."""
