"""The launch file starts the node there is; stand-ins load it, for `launch` is not on PyPI."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from boxgrasp_ros.interfaces import HEARD

PACKAGE = Path(__file__).parents[1] / "boxgrasp_ros"
NAMES = {
    "launch": ["LaunchDescription"],
    "launch.actions": ["DeclareLaunchArgument"],
    "launch.conditions": ["IfCondition"],
    "launch.substitutions": ["LaunchConfiguration", "PathJoinSubstitution"],
    "launch_ros": [],
    "launch_ros.actions": ["Node"],
    "launch_ros.substitutions": ["FindPackageShare"],
}


def recorder(name: str) -> Any:
    return lambda *given, **named: SimpleNamespace(kind=name, given=given, **named)


@pytest.fixture
def description(monkeypatch: pytest.MonkeyPatch) -> Any:
    for module, names in NAMES.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, recorder(name))
        monkeypatch.setitem(sys.modules, module, stand_in)
    path = PACKAGE / "launch" / "grasp_selector.launch.py"
    spec = importlib.util.spec_from_file_location("grasp_selector_launch", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description()


def test_it_starts_the_node_with_topics_that_it_hears(description: Any) -> None:
    (parts,) = description.given
    node, rviz = (part for part in parts if part.kind == "Node")
    scripts = (PACKAGE / "setup.py").read_text("utf-8")
    assert node.package == "boxgrasp_ros" and f"{node.executable} = " in scripts
    relative = {item.name for item in HEARD if item.name[0] not in "/~"}
    assert {name for name, _ in node.remappings} == relative
    assert rviz.package == rviz.executable == "rviz2" and rviz.condition.kind == "IfCondition"


def test_every_argument_is_declared_and_every_file_is_installed(description: Any) -> None:
    (parts,) = description.given
    declared = {part.given[0]: part for part in parts if part.kind == "DeclareLaunchArgument"}
    used = {name for name, _ in next(p for p in parts if p.kind == "Node").remappings}
    assert used | {"params_file", "use_sim_time", "rviz"} == set(declared)
    assert all(part.description for part in declared.values())
    share = declared["params_file"].default_value.given[0]
    assert share[0].kind == "FindPackageShare" and share[0].given == ("boxgrasp_ros",)
    assert (PACKAGE / Path(*share[1:])).is_file()
    installed = Path(sys.prefix, "share", "boxgrasp_ros")
    assert (installed / Path(*share[1:])).is_file()
    assert (installed / "rviz" / "boxgrasp.rviz").is_file()
    assert (installed / "launch" / "grasp_selector.launch.py").is_file()
