"""Sensorless measurement of the backlash gap in robot joints, with honest uncertainty."""

__version__ = "0.1.0"
