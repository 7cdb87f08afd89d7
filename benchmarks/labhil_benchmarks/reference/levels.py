"""Between the text's parameters and ours, both ways, with the covariance.

The text's static level F_s is the sum of our Coulomb and Stribeck levels, so that our Stribeck level is
F_s − F_c, and Var F_s = Var c + Var st + 2·Cov(c, st): without the covariance its error is overstated many
times, because the two levels are estimated against each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from labhil.signals import FloatArray
from labhil_benchmarks.reference.published import Parameter


class Levels:
    """The linear map from parameters of our model, by key, to the ``rows`` of a table of the text."""

    def __init__(self, rows: Sequence[Parameter]) -> None:
        self.keys = tuple(dict.fromkeys(key for row in rows for key in row.keys))
        if len(self.keys) != len(rows):
            raise ValueError(f"{len(rows)} rows need as many parameters of the model, found {len(self.keys)}")
        self._matrix = np.array([[float(key in row.keys) for key in self.keys] for row in rows])

    def to_text(self, ours: Mapping[str, float]) -> FloatArray:
        """The rows' values (rows,) from our values by key."""
        return np.asarray(self._matrix @ np.array([ours[key] for key in self.keys]))

    def to_ours(self, values: Sequence[float] | FloatArray) -> dict[str, float]:
        """Our values by key from the rows' values (rows,)."""
        ours = np.linalg.solve(self._matrix, np.asarray(values, dtype=np.float64))
        return dict(zip(self.keys, ours.tolist(), strict=True))

    def covariance(self, ours: FloatArray, keys: Sequence[str]) -> FloatArray:
        """Covariance (rows, rows) of the rows from ours (P, P), whose rows and columns are ``keys`` (P,)."""
        places = [keys.index(key) for key in self.keys]
        return np.asarray(self._matrix @ ours[np.ix_(places, places)] @ self._matrix.T)

    def jacobian(self, ours: FloatArray, keys: Sequence[str]) -> FloatArray:
        """Slopes (n, rows) by the rows from slopes (n, P) by our ``keys``."""
        places = [keys.index(key) for key in self.keys]
        return np.asarray(np.linalg.solve(self._matrix.T, ours[:, places].T).T)
