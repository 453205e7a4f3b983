"""Find where bench and measurement disagree, and which effect of the catalogue the bench lacks.

Each of :data:`bayesbl.runs.diagnose.METHODS` takes a :class:`~bayesbl.diagnosis.task.Task` and
returns a :class:`~bayesbl.diagnosis.diagnosis.Diagnosis`. ``closed_loop`` simulates speed and
current of a two-mass bench. ``rigid`` has the views of a rigid bench, all with ``inference``:
``inverse`` compares measured and required torque, ``free_motion`` simulates a joint without motor
torque, ``speed_loop`` compares lines of the speed. ``groups`` stores and summarises any diagnosis.
"""
