"""Results of flights: records, the store, evaluation, statistics, comparison."""
