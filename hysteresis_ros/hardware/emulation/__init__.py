"""What emulated devices share: a plant with a clock of its own, faults, a link over TCP, and how they are started."""
