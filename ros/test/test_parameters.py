"""Parameters: declared from the configuration's code, refused in one line."""

import dataclasses
import functools
import math
import os
from pathlib import Path

import pytest
import rclpy
from boxgrasp_ros.parameters import declare, descriptor, in_own_types
from boxgrasp_ros.settings import (
    FIXED,
    NodeConfig,
    markdown_table,
    near_misses,
    rows,
    setting_named,
    settings,
    started,
    updated,
    values,
)
from hypothesis import HealthCheck, given, seed
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from boxgrasp.config import Config, config_hash, load_config
from boxgrasp.errors import ConfigError
from boxgrasp.strict import plain

DOMAIN = 73
REALSENSE = Path(__file__).parents[1] / "boxgrasp_ros" / "config" / "realsense.yaml"
Type = Parameter.Type

# A value a setting, other than its default, that is valid beside the defaults of all others.
OTHER = {
    "base_frame": "arm_base",
    "camera_frame": "camera_color_optical_frame",
    "hand": "thesis",
    "scene.segmentation": "split",
    "scene.network": "net.onnx",
    "scene.sensor": "realsense",
    "scene.workspace_m": [0.2, -0.5, 0.0, 0.9, 0.5, 0.6],
    "scene.min_cluster_size": 40,
    "box.fit": "aligned",
    "mapping.stride": 2,
    "candidates.faces": ["front", "top-parallel"],
    "candidates.refine": "none",
    "gripper.width_m": 0.2,
    "gripper.max_opening_m": 0.1,
    "gripper.name": "mine",
    "gripper.opening_m": 0.1,
    "gripper.T_flange_gripper": [0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0.11, 0, 0, 0, 1],
    "gripper.T_gripper_tcp": [1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
    "checks.plugins": "{keep_out: {corners_m: [[0.4, -0.5, 0], [0.6, 0.5, 1]], soft: null}}",
    "ranker": "top-down",
    "models": "models",
}


def other(setting):
    """A valid value that is not the default."""
    if setting.name in OTHER:
        found = OTHER[setting.name]
        return [float(x) for x in found] if setting.ros_type == "double array" else found
    if setting.ros_type == "bool":
        return not setting.default
    if setting.ros_type == "integer":
        return setting.default + 1
    return setting.default + (min(setting.high, setting.default + 1.0) - setting.default) / 16


@pytest.fixture
def make_node(monkeypatch):
    """Nodes of their own context, with command lines of their own."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    made = []

    def make(*arguments, name="grasp_selector", **keywords):
        context = rclpy.Context()
        rclpy.init(args=["--ros-args", *arguments], context=context, domain_id=DOMAIN)
        node = Node(name, context=context, **keywords)
        made.append((node, context))
        return node

    yield make
    for node, context in made:
        node.destroy_node()
        context.try_shutdown()


@pytest.fixture
def with_parameters(make_node, tmp_path):
    """A node with a parameter file."""

    def make(yaml_lines, at="/**"):
        file = tmp_path / "parameters.yaml"
        lines = "\n".join(f"    {line}" for line in yaml_lines.splitlines())
        file.write_text(f"{at}:\n  ros__parameters:\n{lines}\n", "utf-8")
        return make_node("--params-file", str(file))

    return make


class Running:
    """A node that takes parameters as the package's does."""

    def __init__(self, node):
        self.node = node
        self.config, self.node_config = declare(node)
        node.add_on_set_parameters_callback(self.on_set)

    def on_set(self, parameters):
        try:
            self.config, self.node_config = updated(self.config, self.node_config, parameters)
        except ConfigError as fault:
            return SetParametersResult(successful=False, reason=str(fault))
        return SetParametersResult(successful=True)

    def set(self, **named):
        given = [Parameter(name.replace("__", "."), value=value) for name, value in named.items()]
        return self.node.set_parameters_atomically(given)


def leaf_names(data, place=()):
    for name, value in data.items():
        if isinstance(value, dict) and (*place, name) != ("checks", "plugins"):
            yield from leaf_names(value, (*place, name))
        else:
            yield ".".join((*place, name))


def refused(*parameters, config=None, node_config=None):
    with pytest.raises(ConfigError) as caught:
        updated(config or Config(), node_config or NodeConfig(), parameters)
    line = str(caught.value)
    assert "\n" not in line and line
    return line


def test_every_setting_is_declared_with_its_default(make_node):
    node = make_node()
    config, node_config = declare(node)
    assert config == load_config(None) and node_config == NodeConfig()
    assert config_hash(config) == config_hash(load_config(None))
    names = [*leaf_names(plain(Config())), *leaf_names(plain(NodeConfig()))]
    for boxes in ("gripper.palm", "gripper.finger"):  # these come by `hand`
        names.remove(boxes)
    assert sorted(s.name for s in settings()) == sorted(names)
    assert len(set(names)) == len(names)
    for setting in settings():
        held = node.get_parameter(setting.name)
        assert held.type_.name == setting.ros_type.upper().replace(" ", "_"), setting.name
        assert in_list(held.value) == in_list(setting.default), setting.name
        assert setting.read(held.value) == functools.reduce(
            lambda data, step: data[step],
            setting.path,
            plain(config if setting.of is Config else node_config),
        )


def in_list(value):
    return value if isinstance(value, str | bool | int | float) else list(value)


def test_descriptors_say_what_is_valid(make_node):
    node = make_node()
    declare(node)
    shown = node.describe_parameter("box.turn_gain")
    (bounds,) = shown.floating_point_range
    assert bounds.from_value == 0.0 and bounds.to_value == math.nextafter(1.0, 0.0)
    assert bounds.step == 0.0
    assert shown.description == (
        "share of the area by which turning must shrink it. Valid: a number at least 0 and below 1."
    )
    (bounds,) = node.describe_parameter("max_waiting").integer_range
    assert (bounds.from_value, bounds.to_value, bounds.step) == (1, 100, 0)
    (bounds,) = node.describe_parameter("mapping.stride").integer_range
    assert (bounds.from_value, bounds.to_value) == (0, 100)
    (bounds,) = node.describe_parameter("scene.min_cluster_size").integer_range
    assert (bounds.from_value, bounds.to_value) == (1, 2**63 - 1)
    assert "in place of the node's own." in node.describe_parameter("use_octomap").description
    assert node.describe_parameter("gripper.width_m").additional_constraints == FIXED["gripper"]
    for setting in settings():
        shown = descriptor(setting)
        assert setting.description and "\n" not in shown.description
        for limits in (*shown.integer_range, *shown.floating_point_range):
            assert limits.from_value <= setting.default <= limits.to_value


def test_ranges_end_where_the_library_refuses():
    for setting in settings():
        for bound, away in ((setting.low, -1), (setting.high, 1)):
            if bound is None or setting.fixed:
                continue
            name = setting.name
            if abs(bound) < 2**62 and name != "mapping.resolution_m":
                updated(Config(), NodeConfig(), [Parameter(name, value=bound)])
            if setting.ros_type == "double":
                beyond = math.nextafter(bound, away * math.inf)
            else:
                beyond = bound + away
            if beyond < 2**63:
                assert refused(Parameter(name, value=beyond)).startswith(f"parameters: {name} is ")


@pytest.mark.parametrize("setting", settings(), ids=lambda s: s.name)
def test_every_setting_can_be_set(setting):
    value = other(setting)
    parameter = Parameter(setting.name, Type[setting.ros_type.upper().replace(" ", "_")], value)
    assert parameter.value != setting.default
    config, node_config = started([parameter])
    assert (config == Config()) == (setting.of is NodeConfig)
    again = [
        Parameter(name, setting_type(name), held)
        for name, held in values(config, node_config).items()
    ]
    assert started(again) == (config, node_config)
    assert config_hash(started(again)[0]) == config_hash(config)
    if setting.text:
        assert setting.read(values(config, node_config)[setting.name]) == setting.read(value)
    else:
        assert values(config, node_config)[setting.name] == value
    if setting.fixed:
        assert refused(parameter).endswith(setting.fixed)
        assert updated(config, node_config, [parameter]) == (config, node_config)
    else:
        assert updated(Config(), NodeConfig(), [parameter]) == (config, node_config)


def setting_type(name):
    return Type[setting_named(name).ros_type.upper().replace(" ", "_")]


def test_every_setting_can_be_set_on_a_running_node(make_node):
    running = Running(make_node())
    for setting in settings():
        parameter = Parameter(setting.name, setting_type(setting.name), other(setting))
        (result,) = running.node.set_parameters([parameter])
        assert result.successful == (not setting.fixed), result.reason
        if setting.fixed:
            assert result.reason.endswith(setting.fixed)
            parameter = Parameter(
                setting.name, setting_type(setting.name), setting.default
            )  # what it is, as `ros2 param load` of a dump sets
            assert running.node.set_parameters([parameter])[0].successful
    held = values(running.config, running.node_config)
    for setting in settings():
        if not setting.text:
            assert in_list(running.node.get_parameter(setting.name).value) == held[setting.name]


def test_nothing_changed_keeps_the_objects():
    config, node_config = Config(), NodeConfig()
    pairs = [Parameter("views", value=0), Parameter("scene.max_range_m", value=1.6)]
    after = updated(config, node_config, pairs)
    assert after[0] is config and after[1] is node_config
    after = updated(config, node_config, [Parameter("views", value=3)])
    assert after[0] is config and after[1].views == 3


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        (
            "checks.visible_clearance_m",
            0.7,
            "parameters: checks.visible_clearance_m is 0.7; "
            "valid: a number at least 0 and at most 0.5",
        ),
        (
            "checks.visible_clearance_m",
            "wide",
            "parameters: checks.visible_clearance_m is 'wide'; "
            "valid: a number at least 0 and at most 0.5",
        ),
        ("scene.max_range_m", math.nan, "scene.max_range_m is nan; valid: a finite number"),
        ("views", 21, "parameters: views is 21; valid: a whole number at least 0 and at most 20"),
        ("views", True, "views is true; valid: a whole number at least 0 and at most 20"),
        ("views", 2.0, "views is 2.0; valid: a whole number at least 0 and at most 20"),
        ("use_octomap", 1, "parameters: use_octomap is 1; valid: true or false"),
        ("base_frame", 3, "parameters: base_frame is 3; valid: text"),
        ("base_frame", "", "base_frame is empty; valid: the frame that answers are wanted in"),
        ("camera_frame", "/optical", "camera_frame is '/optical'; valid: a frame's name without"),
        ("candidates.faces", ["fornt"], "unknown face: fornt; valid: left, front, right"),
        ("candidates.faces", None, "candidates.faces is empty; valid: a list, each text"),
        ("candidates.faces", [1, 2], "candidates.faces[0] is 1; valid: text"),
        ("ranker", "best", "parameters: unknown ranker: best; valid: clearance, "),
        (
            "mapping.stride",
            -3,
            "mapping.stride is -3; valid: a whole number at least 1 and at most 100, or 0 for none",
        ),
        ("mapping.stride", 2.5, "mapping.stride is 2.5; valid: a whole number"),
        ("mapping.stride", False, "mapping.stride is false; valid: a whole number"),
        ("scene.network", 7, 'scene.network is 7; valid: text, or "" for none'),
        (
            "scene.workspace_m",
            [0.0, 1.0],
            "scene.workspace_m is a list of 2; valid: 6 numbers, 2 rows of 3 one after the other, "
            "or [] for none",
        ),
        (
            "scene.workspace_m",
            [0.0, 1.0, math.inf] * 2,
            "workspace_m[0][2] is inf; valid: a finite",
        ),
        ("gripper.T_gripper_tcp", [1.0] * 15, "gripper.T_gripper_tcp is a list of 15; valid: 16"),
        ("gripper.T_gripper_tcp", [1.0] * 16, "T_gripper_tcp"),
        ("gripper.max_opening_m", 0.3, "max_opening_m 0.3 exceeds width_m 0.17"),
        ("scene.sensor", "realsens", "scene.sensor is 'realsens'; valid: xtion, realsense, tof or"),
        (
            "scene.sensor",
            "{focal_px: 1}",
            "scene.sensor.focal_px is 1; valid: a number at least 10",
        ),
        ("scene.sensor", "{focl_px: 1}", "did you mean focal_px?"),
        ("scene.sensor", "{focal_px: [", "parameters: scene.sensor: line 1, column 13: "),
        ("checks.plugins", "[1]", "checks.plugins is '[1]'; valid: YAML text of a section, each"),
        ("checks.plugins", "{a: 1}", "parameters: "),
        ("checks.plugins", 4, "checks.plugins is 4; valid: YAML text of a section"),
        (
            "checks.visible_clearence_m",
            0.1,
            "parameters: unknown key 'visible_clearence_m' in checks; valid: visible_clearance_m,",
        ),
        ("checks.visible_clearence_m", 0.1, "; did you mean visible_clearance_m?"),
        ("checks.noise_m", 0.1, "parameters: 'noise_m' in checks is now 'noise_gain'"),
        ("checks.a.b", 0.1, "parameters: unknown key 'a' in checks"),
        ("checks", 5, "parameters: checks is 5; valid: a section"),
        (
            "checks.plugins.keep_out.size_m",
            1.0,
            "unknown parameter 'checks.plugins.keep_out.size_m'; valid: checks.plugins alone, YAML",
        ),
        ("mapping.resolution_m", 0.005, "resolution_m 0.005 makes"),
    ],
)
def test_a_faulty_value_is_refused_in_one_line(name, value, line):
    big = load_config({"mapping": {"half_width_m": 2.0, "height_m": 2.0}})
    config = big if name == "mapping.resolution_m" else Config()
    assert line in refused(Parameter(name, value=value), config=config)
    if config is not big:
        with pytest.raises(ConfigError) as caught:
            started([Parameter(name, value=value)])
        assert line in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        (
            "gripper.length_m",
            0.2,
            "parameters: gripper.length_m stays 0.22: "
            "the hand is fixed while the node runs: restart with the new one",
        ),
        (
            "base_frame",
            "map",
            "parameters: base_frame stays 'base_link': "
            "poses kept in the old frame would be mixed: restart with the new one",
        ),
        ("camera_frame", "map", "parameters: camera_frame stays '': poses kept in the old frame"),
    ],
)
def test_what_is_fixed_stays(name, value, line):
    assert refused(Parameter(name, value=value)).startswith(line)


def test_two_that_are_valid_only_together():
    config = load_config({"mapping": {"half_width_m": 2.0, "height_m": 2.0}})
    finer = Parameter("mapping.resolution_m", value=0.005)
    assert "cells; valid: at most" in refused(finer, config=config)
    smaller = [
        Parameter("mapping.half_width_m", value=0.1),
        Parameter("mapping.height_m", value=0.1),
    ]
    after, _ = updated(config, NodeConfig(), [finer, *smaller])
    assert (after.mapping.resolution_m, after.mapping.half_width_m) == (0.005, 0.1)
    wide = [
        Parameter("gripper.max_opening_m", value=0.3),
        Parameter("gripper.width_m", value=0.35),
    ]
    assert started(wide)[0].gripper.max_opening_m == 0.3


def test_a_running_node_takes_all_or_none(make_node):
    running = Running(make_node())
    before = running.config
    result = running.set(scene__max_range_m=2.0, ranker="best")
    assert not result.successful and "unknown ranker: best" in result.reason
    assert running.config is before
    assert running.node.get_parameter("scene.max_range_m").value == 1.6
    assert running.set(scene__max_range_m=2.0, ranker="top-down").successful
    assert (running.config.scene.max_range_m, running.config.ranker) == (2.0, "top-down")


def test_a_running_node_puts_values_into_their_own_types(make_node):
    running = Running(make_node())
    assert running.set(scene__max_range_m=2).successful
    held = running.node.get_parameter("scene.max_range_m")
    assert held.type_ == Type.DOUBLE and held.value == 2.0
    assert running.config.scene.max_range_m == 2.0
    assert running.set(scene__workspace_m=[0, -1, 0, 1, 1, 1]).successful
    assert running.node.get_parameter("scene.workspace_m").type_ == Type.DOUBLE_ARRAY
    assert running.config.scene.workspace_m == ((0, -1, 0), (1, 1, 1))
    assert running.set(scene__workspace_m=[]).successful  # rclpy takes it for bytes
    assert running.node.get_parameter("scene.workspace_m").type_ == Type.DOUBLE_ARRAY
    assert running.config.scene.workspace_m is None
    assert running.set(mapping__stride=3).successful
    assert running.set(mapping__stride="null", scene__network="~").successful
    assert running.node.get_parameter("mapping.stride").value == 0
    assert running.node.get_parameter("scene.network").value == ""
    assert running.config.mapping.stride is None and running.config.scene.network is None
    for faulty in ({"views": True}, {"scene__max_range_m": "far"}, {"views": 1.0}):
        assert not running.set(**faulty).successful
    assert not running.set(scene__max_range_m=50).successful
    gone = Parameter("scene.network", Type.NOT_SET, None)
    assert not running.node.set_parameters_atomically([gone]).successful


def test_ros_own_parameters_pass(make_node):
    running = Running(make_node("-p", "use_sim_time:=false"))
    before = running.config, running.node_config
    assert running.set(use_sim_time=True).successful
    named = ("use_sim_time", "qos_overrides./depth.subscription.depth", "robot_description")
    parameters = [Parameter(name, value=True) for name in named]
    after = updated(*before, parameters)
    assert after[0] is before[0] and after[1] is before[1]


def test_a_file_is_read(with_parameters):
    node = with_parameters(
        "base_frame: arm_base\nviews: 3\nmax_view_age_s: 2\nranker: top-down\nmodels: null\n"
        "scene:\n  sensor: '{noise_floor_m: 0.002}'\n  workspace_m: [0, -1, 0, 1, 1, 1]\n"
        "  network: ~\nmapping: {stride: null, half_width_m: 1}\n"
        "candidates: {faces: [front, left]}\nchecks: {plugins: {}}\nbox: {}\n"
    )
    config, node_config = declare(node)
    assert (node_config.base_frame, node_config.views) == ("arm_base", 3)
    assert node.get_parameter("max_view_age_s").value == 2.0 and config.models is None
    assert config.scene.sensor_model.noise_floor_m == 0.002
    assert config.scene.workspace_m == ((0, -1, 0), (1, 1, 1)) and config.scene.network is None
    assert config.mapping.stride is None and config.mapping.half_width_m == 1.0
    assert config.candidates.faces == ("front", "left") and config.checks.plugins == {}
    assert node.get_parameter("scene.workspace_m").type_ == Type.DOUBLE_ARRAY


def test_an_empty_list_in_a_file_is_none(with_parameters):
    config, _ = declare(with_parameters("scene:\n  workspace_m: []\n"))
    assert config.scene.workspace_m is None


@pytest.mark.parametrize(
    ("lines", "line"),
    [
        ("checks: {visible_clearence_m: 0.1}", "did you mean visible_clearance_m?"),
        ("scene: {max_range_m: 30}", "scene.max_range_m is 30; valid: a number above 0"),
        ("scene: {max_range_m: far}", "scene.max_range_m is 'far'; valid: a number above 0"),
        ("gripper: {max_opening_m: 0.3}", "max_opening_m 0.3 exceeds width_m"),
        ("use_octomap: maybe", "use_octomap is 'maybe'; valid: true or false"),
        ("box: {fit: yes}", "box.fit is true; valid: yaw, aligned"),
        ("checks: {plugins: {keep_out: {size_m: 1}}}", "valid: checks.plugins alone, YAML text"),
        ("scene: {sensor: {focal_px: 600}}", "valid: scene.sensor alone, xtion, realsense, tof"),
    ],
)
def test_a_faulty_file_is_refused_in_one_line(with_parameters, lines, line):
    node = with_parameters(lines)
    with pytest.raises(ConfigError) as caught:
        declare(node)
    assert line in str(caught.value) and "\n" not in str(caught.value)
    assert not node.has_parameter("base_frame")


def test_the_command_line_and_the_constructor_are_read(make_node):
    node = make_node(
        "-p", "checks.noise_gain:=2", parameter_overrides=[Parameter("views", value=2)]
    )
    config, node_config = declare(node)
    assert (config.checks.noise_gain, node_config.views) == (2.0, 2)


def test_slips_outside_our_sections_are_told(with_parameters, capfd):
    declare(with_parameters("bas_frame: x\nrobot_description: y\nother: {noise_gain: 3}\n"))
    told = capfd.readouterr().err
    assert "parameter 'bas_frame' is not used; did you mean base_frame?" in told
    assert "robot_description" not in told and "other" not in told
    assert near_misses(["check.noise_gain"]) == [
        "parameter 'check.noise_gain' is not used: check is now checks"
    ]
    assert near_misses(["views", "use_sim_time", "checks.noise_gain", "publish_rate"]) == []


def test_the_table_has_every_setting():
    table = markdown_table().splitlines()
    assert len(table) == 2 + len(rows()) == 2 + len(settings())
    assert all(line.count(" | ") == 5 for line in table[2:])
    by_name = {row.name: row for row in rows()}
    assert not by_name["gripper.width_m"].changeable and by_name["views"].changeable
    assert by_name["scene.workspace_m"].default == "[]"
    assert by_name["checks.noise_gain"].type == "double"


def test_settings_need_no_ros():
    import subprocess
    import sys

    code = (
        "import sys; import boxgrasp_ros.settings as s; s.markdown_table(); "
        "sys.exit(any(m.split('.')[0] in ('rclpy', 'rcl_interfaces') for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], env=os.environ, check=False).returncode == 0


def test_realsense_file_is_taken(make_node):
    node = make_node("--params-file", str(REALSENSE))
    config, node_config = declare(node)
    assert config != Config() and config.scene.sensor_model.noise_by_focal
    given = [name for name in node._parameter_overrides if name != "use_sim_time"]
    assert given and all(setting_named(name) for name in given)
    lines = REALSENSE.read_text("utf-8").split("ros__parameters:")[1].splitlines()
    for line in lines:
        if ": " in line.split("#")[0].strip() + " " and not line.strip().startswith("#"):
            alone = line.split("#")[0].strip().endswith(":")
            assert alone or "#" in line, f"no comment why: {line}"
    assert node_config != NodeConfig()


FLOATS = st.floats() | st.floats(-1.0, 25.0)
INTS = st.integers(-(2**63), 2**63 - 1) | st.integers(-2, 30)
TEXTS = (
    st.text(max_size=12)
    | st.sampled_from(["", "null", "xtion", "{a: {b: [1, 2]}}", "[[", "{a: &x [*x]}", "? {a: 1}"])
    | st.sampled_from(["{focal_px: 300}", "!!python/name:os.system", "2020-01-01", "{1: 2}", "\0"])
)
VALUES = st.one_of(
    *(
        st.builds(lambda value, kind=kind: (Type[kind], value), values)
        for kind, values in (
            ("NOT_SET", st.none()),
            ("BOOL", st.booleans()),
            ("INTEGER", INTS),
            ("DOUBLE", FLOATS),
            ("STRING", TEXTS),
            ("BOOL_ARRAY", st.lists(st.booleans(), max_size=6)),
            ("INTEGER_ARRAY", st.lists(INTS, max_size=16) | st.lists(INTS, min_size=6, max_size=6)),
            ("DOUBLE_ARRAY", st.lists(FLOATS, max_size=16)),
            ("STRING_ARRAY", st.lists(TEXTS, max_size=4)),
            ("BYTE_ARRAY", st.lists(st.binary(min_size=1, max_size=1), max_size=4)),
        )
    )
)
NAMES = st.sampled_from([s.name for s in settings()]) | st.builds(
    ".".join,
    st.lists(
        st.sampled_from(["checks", "scene", "mapping", "sensor", "plugins", "stride", "x", ""]),
        min_size=1,
        max_size=4,
    ),
)
PARAMETERS = st.lists(
    st.builds(lambda name, typed: Parameter(name, *typed), NAMES, VALUES), max_size=4
)


@seed(1)
@hypothesis_settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(PARAMETERS)
def test_any_parameters_are_taken_or_refused_in_one_line(parameters):
    for take in (started, functools.partial(updated, Config(), NodeConfig())):
        try:
            config, node_config = take(parameters)
        except ConfigError as fault:
            assert "\n" not in str(fault)
            continue
        assert started_again(config, node_config) == (config, node_config)
    for before, after in zip(parameters, in_own_types(parameters), strict=True):
        setting = setting_named(before.name)
        if setting is not None and before.type_ != Type.NOT_SET and after is not before:
            assert after.type_ == setting_type(before.name)
            assert outcome(before) == outcome(after)


def outcome(parameter):
    try:
        return started([parameter])
    except ConfigError:
        return None


def started_again(config, node_config):
    held = values(config, node_config)
    return started([Parameter(name, setting_type(name), value) for name, value in held.items()])


def test_every_field_of_the_node_is_told_of():
    names = {item.name for item in dataclasses.fields(NodeConfig)}
    assert names == {s.name for s in settings() if s.of is NodeConfig}


def test_a_hand_comes_by_its_file_and_single_sizes_win(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(
        "{length_m: 0.2, width_m: 0.2, thickness_m: 0.06, max_opening_m: 0.08, "
        "palm: [{x_m: [0, 0.15], y_m: [-0.1, 0.1], z_m: [-0.03, 0.03]}], "
        "finger: [{x_m: [0.1, 0.2], y_m: [0.04, 0.06], z_m: [-0.01, 0.01]}]}"
    )
    given = [Parameter("hand", value=str(file)), Parameter("gripper.opening_m", value=0.06)]
    config, node_config = started(given)
    assert (config.gripper.name, len(config.gripper.palm), config.gripper.fingers_open_m) == (
        "mine", 1, 0.06,
    )  # fmt: skip
    assert node_config.hand == str(file)
    for value, said in (("nobody", "unknown gripper: nobody; valid: thesis"), ("a.yaml", "a.yaml")):
        with pytest.raises(ConfigError) as caught:
            started([Parameter("hand", value=value)])
        assert str(caught.value).startswith("parameters: hand: ") and said in str(caught.value)
