"""What the viewer shows: from messages, recordings and sessions to a picture, and the program that shows it."""
