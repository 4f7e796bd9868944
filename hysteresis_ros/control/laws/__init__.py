"""The controllers: each file or folder here declares one, as ``CONTROLLER``, and is found by the registry."""
