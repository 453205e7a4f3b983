"""What an identification says where nothing explains the recordings."""

from bayesbl.identification.groups import left_over
from bayesbl.matching.predictive_check import RepeatingPower


def test_what_is_left_is_told_where_it_stands_out() -> None:
    """By channel, recording and orders; a larger ratio that noise explains is not meant."""
    check = [
        RepeatingPower("first", "motor_speed_rpm", 0, 90.0, 0.2),
        RepeatingPower("first", "motor_speed_rpm", 8, 3.0, 1e-4),
        RepeatingPower("second", "motor_current_a", 32, 5.26, 1e-9),
    ]
    assert "motor_current_a of second, orders up to 32: 5.26 times" in left_over(check)
    mean = [RepeatingPower("first", "motor_speed_rpm", 0, 90.0, 1e-5)]
    assert "motor_speed_rpm of first, the mean: 90 times" in left_over(mean)
