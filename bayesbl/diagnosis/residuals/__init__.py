"""Residuals of recordings in steady rotation, taken apart: what repeats with which angle or time.

Only the forward method (:mod:`bayesbl.diagnosis.closed_loop`) compares steady rotation today;
nothing here knows that method.
"""
