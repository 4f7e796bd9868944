"""Recordings: bags, CSV and NPZ, all read into and written from one dataset type (time, named signals, units)."""

from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run, save_run
from hysteresis_ros.signals import COLUMNS

__all__ = ["COLUMNS", "Recording", "load_run", "save_run"]
