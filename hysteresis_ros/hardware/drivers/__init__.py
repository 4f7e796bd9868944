"""The drivers: each file or folder here declares one, as ``DRIVER``, and is found by the registry."""
