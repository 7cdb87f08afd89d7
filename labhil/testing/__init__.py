"""Contract tests that every driver plugin can subclass."""
