"""Where a model and a recording disagree, which physics is missing, and whether it helps."""

import sys

from labhil.public import CallablePackage

sys.modules[__name__].__class__ = CallablePackage
