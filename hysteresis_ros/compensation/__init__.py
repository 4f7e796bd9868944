"""Inverses of the hysteresis models, and the compensator that uses them."""
