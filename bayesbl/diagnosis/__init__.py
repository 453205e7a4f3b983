"""Where bench and measurement disagree, and which effect of the catalogue the bench lacks.

A :class:`~bayesbl.diagnosis.task.Task` goes in, a :class:`~bayesbl.diagnosis.diagnosis.Diagnosis`
comes out, by one of :data:`bayesbl.runs.diagnose.METHODS`. ``closed_loop`` simulates a
two-mass bench beside speed and current. ``rigid`` has the views of a rigid bench: ``inverse``
compares measured motion with the torque it should have needed, ``free_motion`` a joint let go
without torque with its simulation, ``speed_loop`` lines of the speed alone; all by ``inference``.
``groups`` stores and summarises any diagnosis.
"""
