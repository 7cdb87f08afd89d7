"""MCAP in, numpy out; and the tables of others in, ours out."""
