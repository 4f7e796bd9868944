"""Kim, Kim & Park 2009: axis, identification and gait of an inchworm."""
