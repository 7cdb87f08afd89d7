"""The functions and results of ``import labhil``, which the commands call as well."""
