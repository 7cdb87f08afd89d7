"""What each command of ``labhil`` takes and does, a room for each kind of work."""
