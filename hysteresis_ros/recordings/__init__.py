"""Recordings: bags, CSV and NPZ, all read into and written from one dataset type (time, named signals, units)."""

from hysteresis_ros.recordings.dataset import COLUMNS, Recording
from hysteresis_ros.recordings.files import load_run, save_run

__all__ = ["COLUMNS", "Recording", "load_run", "save_run"]
