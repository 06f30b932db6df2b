"""Reports: tables and pages, for runs of language models, sweeps, commands and the documentation."""
