"""The safety layer of a device: its host process with limits, interlocks and watchdog, and the recorder."""
