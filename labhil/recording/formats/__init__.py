"""The file formats of others, one room each: their tables as columns, our recordings as their files."""
