"""What measures labhil: the reference text's tables, the statistics, many sealed trials. See ../README.md."""
