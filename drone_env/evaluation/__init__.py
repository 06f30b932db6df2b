"""Episodes on splits, their results and figures, and the analysis of a flight."""
