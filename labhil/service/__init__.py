"""What keeps a device honest: its host, and the recorder."""
