"""Many joints: each recording measured once, wear of each joint and of each type of gearbox."""
