"""Publication figures from a stored result alone; each module that declares one adds it."""
