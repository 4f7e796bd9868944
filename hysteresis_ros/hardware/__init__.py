"""Drivers: what stands in the simulated plant's place when there is a device, and how it is found and guarded."""
