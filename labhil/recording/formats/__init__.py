"""Foreign file formats, a module for each: readers that return tables, and writers of recordings."""
