"""The rules of the world, once."""
