"""From the parameter tables of the blocks to ROS 2 parameters and back."""

from __future__ import annotations

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from hysteresis_ros.errors import HysteresisError, ParameterError, Problem
from hysteresis_ros.parameters import ARRAY_TYPES

#: Parameters that ROS itself puts on every node.
_ROS_OWN = ("use_sim_time", "start_type_description_service")


class ParameterInterface:
    """Declares a parameter table on a node and keeps the typed parameters in step with it.

    Parameters
    ----------
    node : rclpy.node.Node
        The node.
    cls : type of Parameters
        Its parameters.
    apply : callable
        Called with the new typed parameters at a change while configured; refuses them by ParameterError.
    """

    def __init__(self, node, cls, apply):
        self._node, self._cls, self._apply = node, cls, apply
        self._rows = {row.name: row for row in cls.table()}
        self.typed = None
        for row in self._rows.values():
            descriptor = ParameterDescriptor(
                name=row.name,
                description=f"{row.description} [{row.unit}]" if row.unit else row.description,
                additional_constraints=row.allowed(),
                read_only=row.read_only,
                dynamic_typing=True,
            )
            if node.has_parameter(row.name):  # use_sim_time: every node has it from the start
                continue
            default = list(row.default) if isinstance(row.default, tuple) else row.default
            node.declare_parameter(row.name, None if row.required else default, descriptor)
        node.add_on_set_parameters_callback(self._check)

    def read(self):
        """Return the typed parameters.

        Raises
        ------
        ParameterError
            Names every unknown, missing, mistyped or out-of-range parameter.
        """
        values = self._values()
        for name, override in self._node._parameter_overrides.items():
            if name not in values and name not in _ROS_OWN and not name.startswith("qos_overrides."):
                values.setdefault(name, override.value)
        self.typed = self._cls.from_mapping(values)
        return self.typed

    def _values(self) -> dict:
        values = {}
        for name in self._rows:
            parameter = self._node.get_parameter(name)
            if parameter.type_ != Parameter.Type.NOT_SET:
                values[name] = self._value(name, parameter.value)
        return values

    def _value(self, name: str, value):
        """Return a value in plain Python types; ROS gives an empty array of unknown type as None or as bytes."""
        if isinstance(value, (str, bool, int, float)):
            return value
        if not value and self._rows[name].type in ARRAY_TYPES:
            return ()
        return value if value is None else list(value)

    def _check(self, changes) -> SetParametersResult:
        changed = {
            change.name: self._value(change.name, change.value) for change in changes if change.name in self._rows
        }
        own = [name for name in changed if name in _ROS_OWN]
        if not changed or own == list(changed):
            return SetParametersResult(successful=True)
        try:
            if own or len(changed) < len(changes):
                # another callback may refuse these after ours was applied: then nothing would be atomic any more
                raise ParameterError([Problem(", ".join(own), "", "set it by itself, not together with others")])
            if self.typed is None:
                for name, value in changed.items():
                    self._rows[name].convert(value)
            else:
                # the only callback for these names on this node: what it accepts is set at once, atomically
                typed = self._cls.from_mapping(self._values() | changed)
                self._apply(typed)
                self.typed = typed
        except HysteresisError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)
