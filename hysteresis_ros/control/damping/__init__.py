"""Damping: an inner loop around the resonances, or filters before them, in front of which every controller stands."""
