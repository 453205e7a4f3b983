"""Where an executed page starts: a folder with the examples and two CSV files of its own."""

import csv
import os
import shutil
from math import pi
from pathlib import Path

shutil.copytree(Path(os.environ["PYTHONPATH"], "configs"), "configs")
os.environ["COLUMNS"] = "88"

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
