"""Linear algebra on one thread: on busy cores, threads waiting for one another cost tenfold.

Set before NumPy is imported; processes that tests start inherit it.
"""

from __future__ import annotations

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
