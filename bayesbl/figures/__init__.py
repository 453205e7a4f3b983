"""Publication figures from a stored result alone; nothing is fitted again."""

from bayesbl.figures.bench_draws import bench_draws
from bayesbl.figures.convergence import convergence
from bayesbl.figures.corner import corner
from bayesbl.figures.curve import curve
from bayesbl.figures.degrees import degrees
from bayesbl.figures.discrepancy import discrepancy
from bayesbl.figures.disturbance import disturbance
from bayesbl.figures.draw import draw_all
from bayesbl.figures.gap import gap
from bayesbl.figures.misfit import misfit
from bayesbl.figures.noise import noise
from bayesbl.figures.signal import signal
from bayesbl.figures.trace import trace
from bayesbl.figures.wear import wear

__all__ = [
    "bench_draws",
    "convergence",
    "corner",
    "curve",
    "degrees",
    "discrepancy",
    "disturbance",
    "draw_all",
    "gap",
    "misfit",
    "noise",
    "signal",
    "trace",
    "wear",
]
