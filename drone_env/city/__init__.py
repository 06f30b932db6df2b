"""Real places as terrain: the file format of a city, and what turns maps of others into it."""
