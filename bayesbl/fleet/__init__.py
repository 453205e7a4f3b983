"""Many joints: recordings measured once, and the wear of each joint and each type of gearbox."""
