"""What the configuration kept in a recording says about a node."""

from __future__ import annotations

from hysteresis_ros.errors import HysteresisError


def configured(text: str, node: str, namespace: str = "") -> dict:
    """Return the flat dotted parameters of ``node``; empty when the text is empty or no ROS 2 parameter file.

    A recording must stay readable whatever text somebody published on ``configuration``, so nothing is raised.
    """
    if not text:
        return {}
    from hysteresis_ros.configuration import parse_configuration

    try:
        return parse_configuration(text, "configuration of the recording").node(node, namespace)
    except HysteresisError:
        return {}
