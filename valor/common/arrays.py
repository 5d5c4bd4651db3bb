"""The array of floats that vectors, matrices and their likes are; shapes stand where one is declared."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
