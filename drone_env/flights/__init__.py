"""The one record of a flight: who flew which actions over which map; sessions, the store, and JSON files of it."""
