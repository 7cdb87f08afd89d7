"""Where a model and a recording disagree, which physics is missing, and whether it helps."""
