"""Where bench and measurement disagree, and which effect of the catalogue the bench lacks.

A :class:`~bayesbl.diagnosis.task.Task` goes in, a :class:`~bayesbl.diagnosis.diagnosis.Diagnosis`
comes out, by one of :data:`~bayesbl.diagnosis.methods.METHODS`. ``closed_loop`` simulates a
two-mass bench beside speed and current; ``rigid`` compares measured motion with the torque it
should have needed; ``free_motion`` a joint let go without torque. The last two name effects by
``inference``. ``residuals`` takes apart what a simulation in steady rotation does not explain.
``groups`` and ``summary`` store and summarise any diagnosis.
"""
