"""Publication figures from a stored result alone; nothing is fitted again."""

from bayesbl.presentation.figures.bench_draws import bench_draws
from bayesbl.presentation.figures.convergence import convergence
from bayesbl.presentation.figures.corner import corner
from bayesbl.presentation.figures.curve import curve
from bayesbl.presentation.figures.degrees import degrees
from bayesbl.presentation.figures.disturbance import disturbance
from bayesbl.presentation.figures.draw import draw_all
from bayesbl.presentation.figures.gap import gap
from bayesbl.presentation.figures.misfit import misfit
from bayesbl.presentation.figures.noise import noise
from bayesbl.presentation.figures.residuals_by_angle import residuals_by_angle
from bayesbl.presentation.figures.signal import signal
from bayesbl.presentation.figures.trace import trace
from bayesbl.presentation.figures.wear import wear

__all__ = [
    "bench_draws",
    "convergence",
    "corner",
    "curve",
    "degrees",
    "disturbance",
    "draw_all",
    "gap",
    "misfit",
    "noise",
    "residuals_by_angle",
    "signal",
    "trace",
    "wear",
]
