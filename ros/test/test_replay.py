"""A bag replayed to the node, each in a process of its own: the answers are the offline ones."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from boxgrasp_msgs.msg import Target
from boxgrasp_msgs.srv import SelectGrasp
from boxgrasp_ros import replay
from boxgrasp_ros.grasp_selector import LATCHED
from moving_bags import (
    CLOUD,
    DEPTH,
    EVERY_S,
    PACKED,
    START_S,
    TARGET_POINT,
    add_view,
    cast_bag,
    cast_view,
    plain,
)
from PIL import Image
from rclpy.node import Node
from scenes import BASE
from waiting import wait_until

from boxgrasp import GraspSelector, load_capture
from boxgrasp import Target as LibraryTarget
from boxgrasp.simulate import demo_scene

FRAMES = 4
TOPICS = ("cloud", "depth", "compressed_depth", "camera_info", "color")
POINT = ("--point", *map(str, TARGET_POINT))
Run = Callable[..., subprocess.Popen[str]]


def _hears_interrupts() -> None:
    """Undo what a shell does to what it starts in the background: ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames as clouds, raw and compressed depth."""
    return cast_bag("mcap", tmp_path_factory.mktemp("bag"), FRAMES, (CLOUD, DEPTH, PACKED))


@pytest.fixture
def run(ros_env: dict[str, str]) -> Iterator[Run]:
    """Start one of the package's modules; it is ended after the test."""
    started = []

    def start(module: str, *arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", f"boxgrasp_ros.{module}", *arguments],
            preexec_fn=_hears_interrupts,
            env=ros_env,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def start_node(run: Run, *parameters: str, reliable: bool = True) -> subprocess.Popen[str]:
    given = ["use_sim_time:=true", f"base_frame:={BASE}", *parameters]
    if reliable:
        given += [f"qos_overrides./{t}.subscription.reliability:=reliable" for t in TOPICS]
    return run("grasp_selector", "--ros-args", *(word for p in given for word in ("-p", p)))


def replayed(run: Run, *arguments: Any) -> tuple[int, list[str], list[str]]:
    """Exit status, lines of standard output, lines of standard error."""
    process = run("replay", *map(str, arguments))
    told, complaints = process.communicate(timeout=120)
    assert "Traceback" not in complaints, complaints
    return process.returncode, told.splitlines(), complaints.splitlines()


def offline(path: Path, topic: str, stamp: float, target: LibraryTarget) -> dict[str, Any]:
    capture = load_capture(path, topic=topic, stamp=stamp, base_frame=BASE)
    return GraspSelector().select(capture, target).to_dict()


def stamp_of(name: str) -> float:
    return float(name.rpartition("#")[2])


def assert_offline_answers(
    lines: list[str], path: Path, topic: str, target: LibraryTarget, frames: int = FRAMES
) -> None:
    live = [json.loads(line) for line in lines]
    stamps = [stamp_of(answer["capture"]) for answer in live]
    np.testing.assert_allclose(stamps, START_S + EVERY_S * np.arange(frames), atol=1e-6)
    for stamp, answer in zip(stamps, live, strict=True):
        assert plain(answer) == json.loads(json.dumps(plain(offline(path, topic, stamp, target))))
        assert answer["capture"].startswith(f"{path}#")
        assert answer["timings_ms"]["total"] > 0


def test_live_answers_are_the_offline_ones(
    run: Run, bag: Path, make_node: Callable[..., Node], tmp_path: Path
) -> None:
    start_node(run)
    by_point = LibraryTarget(point=TARGET_POINT)
    for topic in (CLOUD, DEPTH, PACKED):  # the later ones start at a time before the node's view
        status, told, said = replayed(run, bag, "--topic", topic, *POINT, "--json")
        assert (status, said) == (0, [])
        assert_offline_answers(told, bag, topic, by_point)
        poses = {str(json.loads(line)["T_base_camera"]) for line in told}
        assert len(poses) == FRAMES  # it moves

    u, v = cast_view(0).target_pixel or (0, 0)
    mask = demo_scene().view().object_ids == demo_scene().target_id
    rows, columns = np.nonzero(mask)
    box = tuple(int(at) for at in (columns.min(), rows.min(), columns.max(), rows.max()))
    Image.fromarray(mask.astype(np.uint8) * 255).save(tmp_path / "mask.png")
    for words, target in (
        (("--pixel", u, v), LibraryTarget(pixel=(u, v))),
        (("--box", *box), LibraryTarget(box=box)),
        (("--object", 2), LibraryTarget(object=2)),
        (("--mask", tmp_path / "mask.png"), LibraryTarget(mask=mask)),
    ):
        status, told, said = replayed(
            run, bag, "--topic", CLOUD, *words, "--frames", 1, "--json", "--base-frame", BASE
        )
        assert (status, said) == (0, []), words
        assert_offline_answers(told, bag, CLOUD, target, frames=1)

    old = cast_bag("ros1", tmp_path / "old", 2)
    status, told, _ = replayed(run, old, *POINT, "--json")  # the only topic of views
    assert status == 0
    assert_offline_answers(told, old, DEPTH, by_point, frames=2)

    status, told, said = replayed(run, bag, "--topic", CLOUD, "--frames", 1, "--json")
    assert status == 2 and len(said) == 1 and "no target" in said[0]
    error = json.loads(told[0])
    assert list(error) == ["capture", "error"] and "no target" in error["error"]

    latched = make_node("client").create_publisher(Target, "/grasp_selector/target", LATCHED)
    wait_until(latched.get_subscription_count, what="the node")
    message = Target(kind=Target.POINT)
    place = message.point.point
    place.x, place.y, place.z = TARGET_POINT
    latched.publish(message)
    time.sleep(0.2)
    status, told, said = replayed(run, bag, "--topic", CLOUD, "--frames", 1)
    assert (status, said, len(told)) == (0, [], 1)
    assert told[0].startswith(f"{bag}#100.000000000: grasp: ") and "opening" in told[0]

    status, told, said = replayed(
        run, bag, "--topic", CLOUD, *POINT, "--frames", 1, "--base-frame", "map"
    )
    assert status == 2 and told == [] and len(said) == 1 and "'base_link'" in said[0]


def test_a_frame_without_a_pose_does_not_stop_the_others(run: Run, tmp_path: Path) -> None:
    from bag_files import BagMaker  # type: ignore[import-not-found]
    from moving_bags import ARM, CAMERA, add_pose, arm_from_camera, arm_pose, written

    maker = BagMaker("db3")
    for stamp in (START_S + 0.05, START_S + 0.25):  # the first view comes before
        add_pose(maker, stamp, arm_pose(stamp), BASE, ARM)
    add_pose(maker, START_S, arm_from_camera(), ARM, CAMERA, static=True)
    for number in range(2):
        add_view(maker, START_S + EVERY_S * number, cast_view(number), (DEPTH,))
    path = written(maker, tmp_path / "bag")
    start_node(run)
    status, told, said = replayed(run, path, *POINT, "--json")
    assert status == 2 and len(told) == 2 and len(said) == 1 and "100.05" in said[0]
    assert "100.05" in json.loads(told[0])["error"]
    answer = json.loads(told[1])
    expected = offline(path, DEPTH, START_S + EVERY_S, LibraryTarget(point=TARGET_POINT))
    assert plain(answer) == json.loads(json.dumps(plain(expected)))


def test_best_effort_is_told_and_views_are_sent_again(run: Run, bag: Path) -> None:
    start_node(run, reliable=False)
    words = ("--topic", PACKED, *POINT, "--json", "--frames", 2, "--timeout", 60)
    status, told, said = replayed(run, bag, *words)
    assert (status, len(told)) == (0, 2), said
    assert len(said) == 1 and "best effort" in said[0]
    assert "qos_overrides./compressed_depth.subscription.reliability:=reliable" in said[0]


def test_names_can_be_others(run: Run, bag: Path) -> None:
    names = ("-r", "__ns:=/left", "-r", "__node:=chooser", "-r", "depth:=/left/range")
    reliable = "qos_overrides./left/range.subscription.reliability:=reliable"
    given = ("-p", "use_sim_time:=true", "-p", reliable)
    process = run("grasp_selector", "--ros-args", *names, *given)
    status, told, _ = replayed(
        run, bag, "--topic", DEPTH, *POINT, "--frames", 1, "--node", "chooser",
        "--ros-args", "-r", "__ns:=/left", "-r", "depth:=range",
    )  # fmt: skip
    assert (status, len(told)) == (0, 1)
    status, told, said = replayed(
        run, bag, "--topic", DEPTH, *POINT, "--node", "/left/chooser", "--timeout", 2
    )
    assert (status, told) == (2, []) and len(said) == 1 and "/depth" in said[0]
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=5) == 0


def test_two_nodes_of_a_name_are_told(run: Run, bag: Path, make_node: Callable[..., Node]) -> None:
    node = make_node("another")
    for _ in range(2):
        node.create_service(SelectGrasp, "/grasp_selector/select", lambda _, reply: reply)
    status, told, said = replayed(run, bag, *POINT)
    assert (status, told, len(said)) == (2, [], 1) and "2 nodes" in said[0]


def test_a_node_without_sim_time_is_told(run: Run, bag: Path) -> None:
    run("grasp_selector")
    status, told, said = replayed(run, bag, *POINT)
    assert (status, told) == (2, []) and "use_sim_time:=true" in said[-1]


def test_ctrl_c_ends_it_quietly(run: Run, bag: Path) -> None:
    process = run("replay", str(bag), "--timeout", "100")
    time.sleep(3.0)  # it waits for the node
    process.send_signal(signal.SIGINT)
    told, said = process.communicate(timeout=5)
    assert (process.returncode, told, said) == (130, "", "")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "BAG"),
        (("gone.mcap",), "gone.mcap: no such file"),
        (("BAG", "--topic", "/nowhere"), "/nowhere"),
        (("BAG", "--pixel", "1", "2", "--object", "1"), "not allowed"),
        (("BAG", "--frames", "0"), "valid: 1 or more"),
        (("BAG", "--timeout", "nan"), "valid: seconds"),
        (("BAG", "--box", "5", "5", "4", "9"), "U0 <= U1"),
        (("BAG", "--object", "99999999999"), "too large"),
        (("BAG", "--mask", "gone.png"), "gone.png"),
        (("BAG", "--node", "no name"), "no name"),
        (("BAG", "--timeout", "0.5"), "/grasp_selector/select"),
    ],
)
def test_bad_input_is_one_line(
    words: tuple[str, ...],
    said: str,
    bag: Path,
    ros_env: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", ros_env["ROS_DOMAIN_ID"])
    status = replay.main(["replay", *(str(bag) if word == "BAG" else word for word in words)])
    told = capfd.readouterr()
    assert status == 2 and told.out == ""
    assert len(told.err.splitlines()) == 1 and told.err.startswith("replay: ") and said in told.err


def test_help_ends_well(capsys: pytest.CaptureFixture[str]) -> None:
    assert replay.main(["replay", "--help"]) == 0
    assert "--mask" in capsys.readouterr().out
