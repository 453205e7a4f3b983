"""Where an executed page starts: a folder with the examples and two CSV files of its own."""

import csv
import os
import shutil
import subprocess
from math import pi
from pathlib import Path

from IPython import get_ipython

shutil.copytree(Path(os.environ["PYTHONPATH"], "configs"), "configs")
os.environ["COLUMNS"] = "88"
for forced in ("FORCE_COLOR", "CLICOLOR_FORCE"):  # which Jupyter sets
    os.environ.pop(forced, None)

# The example recordings as a drive's own program would write them.
for own, example in (("march", "before"), ("july", "after")):
    with open(f"configs/recordings/wear_{example}.csv", newline="", encoding="utf-8") as source:
        rows = list(csv.DictReader(source))
    with open(f"{own}.csv", "w", encoding="utf-8") as file:
        file.write("t [ms];n_mot [rad/s];I_q [A]\n")
        for row in rows:
            time_ms, speed = 1e3 * float(row["time_s"]), float(row["motor_speed_rpm"]) * pi / 30
            line = f"{time_ms:.0f};{speed:.4f};{float(row['motor_current_a']):.4f}\n"
            file.write(line.replace(".", ","))


def shell(_: str, commands: str) -> None:
    """What they print, in its order and in one piece; IPython's own ``%%sh`` gives it in many."""
    ran = subprocess.run(
        ["bash", "-ec", commands], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    print(ran.stdout, end="")
    ran.check_returncode()


get_ipython().register_magic_function(shell, "cell", "sh")
