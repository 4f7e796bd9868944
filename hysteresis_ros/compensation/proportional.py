"""No compensation: the voltage is the wanted displacement over the nominal gain."""

from __future__ import annotations

from hysteresis_ros.models.proportional import proportional_inverse

__all__ = ["proportional_inverse"]
