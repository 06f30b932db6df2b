"""Data sets of flights whose every step is labelled with the exact values of its state: `build_dataset`."""
