"""Which controller and compensator for an axis: all of them on its plant, under the same conditions."""
