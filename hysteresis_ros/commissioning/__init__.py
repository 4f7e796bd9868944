"""Commissioning: from a new parameter file to a closed loop that was judged, stage by stage; no ROS."""
