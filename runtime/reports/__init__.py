"""What a run leaves for people: the folder of its results, pictures, charts and the page about it."""
