"""The world as Gymnasium environments."""
