"""Contract tests that every driver plugin can subclass; needs pytest."""

from labhil.extras import require

require("pytest", "labhil.testing")

from labhil.testing.contract import DriverContract  # noqa: E402 - asks for pytest

__all__ = ["DriverContract"]
