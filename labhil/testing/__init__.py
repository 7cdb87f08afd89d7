"""Contract tests that every driver plugin can subclass; needs pytest."""

from labhil.errors import MissingExtraError

try:
    import pytest  # noqa: F401
except ImportError as error:
    raise MissingExtraError("pytest", "test", "labhil.testing") from error

from labhil.testing.contract import DriverContract

__all__ = ["DriverContract"]
