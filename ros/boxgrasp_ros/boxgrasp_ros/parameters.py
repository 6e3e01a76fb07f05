"""The node's parameters, declared from the configuration's own code."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from boxgrasp.config import Config
from boxgrasp_ros.settings import (
    NodeConfig,
    Row,
    Setting,
    markdown_table,
    near_misses,
    rows,
    setting_named,
    settings,
    started,
    updated,
    values,
)

__all__ = [
    "NodeConfig",
    "Row",
    "declare",
    "descriptor",
    "in_own_types",
    "markdown_table",
    "rows",
    "updated",
    "values",
]


def declare(node: Node) -> tuple[Config, NodeConfig]:
    """Declare every setting as a parameter, with what the node was started with.

    Whole numbers set for numbers, and null where a setting may be none, are from then on put into
    the parameter's own type before ROS checks it. What the node refuses or takes while it runs is
    for its own callback, with `updated`.

    Args:
        node: on which none of them is declared yet.

    Returns:
        The library's configuration and the node's.

    Raises:
        ConfigError: an unknown name in one of our sections, a wrong type, a value out of its
            range, values that contradict each other; one line.
    """
    given = _overrides(node)
    config, node_config = started(given.values())
    held = values(config, node_config)
    for line in near_misses(given):
        node.get_logger().warning(line)
    for setting in settings():
        parameter = _parameter(setting, held[setting.name])
        # Declared by its type and then set: an empty list alone would be declared as bytes.
        node.declare_parameter(
            setting.name, parameter.type_, descriptor(setting), ignore_override=True
        )
        node.set_parameters([parameter])
    node.add_pre_set_parameters_callback(in_own_types)
    return config, node_config


def descriptor(setting: Setting) -> ParameterDescriptor:
    """What ROS's tools show of a setting.

    Args:
        setting: any.

    Returns:
        Its meaning, its valid values in words, its range where it has one, and why it is fixed
        where it is.
    """
    shown = ParameterDescriptor(
        name=setting.name,
        description=f"{setting.description.rstrip('.')}. Valid: {setting.valid}.",
        additional_constraints=setting.fixed,
    )
    if setting.low is None or setting.high is None:
        return shown
    if setting.ros_type == "integer":
        shown.integer_range = [
            IntegerRange(from_value=int(setting.low), to_value=int(setting.high), step=0)
        ]
    else:
        shown.floating_point_range = [
            FloatingPointRange(
                from_value=float(setting.low), to_value=float(setting.high), step=0.0
            )
        ]
    return shown


def in_own_types(parameters: list[Parameter]) -> list[Parameter]:
    """Parameters as they are declared: 1 for a number is 1.0, `null` is none.

    Args:
        parameters: about to be set.

    Returns:
        The same, those that are put into their own type apart.
    """
    return [_own_type(parameter) for parameter in parameters]


def _own_type(parameter: Parameter) -> Parameter:
    setting = setting_named(parameter.name)
    if setting is None or parameter.type_ == Parameter.Type.NOT_SET:
        return parameter
    value = setting.held(parameter.value)
    return parameter if value is None else _parameter(setting, value)


def _parameter(setting: Setting, value: Any) -> Parameter:
    return Parameter(setting.name, _type(setting), value)


def _type(setting: Setting) -> Parameter.Type:
    return Parameter.Type[setting.ros_type.upper().replace(" ", "_")]


def _overrides(node: Node) -> dict[str, Parameter]:
    """What the command line, launch file, parameter files and constructor set, by name.

    rclpy has no public way to ask, short of declaring all of them, other nodes' too.
    """
    return dict(node._parameter_overrides)
