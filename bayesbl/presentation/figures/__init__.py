"""Figures of a stored result; each module declares some."""
