"""Poses from files, in every form, and what is said of files that hold none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from boxgrasp.cli import main
from boxgrasp.errors import CaptureError
from boxgrasp.io.pose import load_pose

FORMS = {
    "rows.json": lambda T, q: json.dumps(T.tolist()),
    "rows.yaml": lambda T, q: yaml.safe_dump(T.tolist()),
    "capture.json": lambda T, q: json.dumps({"T_base_camera": T.tolist(), "depth_scale": 0.001}),
    "parts.json": lambda T, q: json.dumps({"position": T[:3, 3].tolist(), "quaternion": q}),
    "ros.yml": lambda T, q: yaml.safe_dump(
        {
            "translation": dict(zip("xyz", T[:3, 3].tolist(), strict=True)),
            "rotation": dict(zip("xyzw", q, strict=True)),
        }
    ),
    "seven.yaml": lambda T, q: yaml.safe_dump([*T[:3, 3].tolist(), *q]),
}


@pytest.mark.parametrize("name", [*FORMS, "rows.npy", "seven.npy"])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_every_form_gives_back_the_pose(tmp_path: Path, name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = Rotation.random(rng=rng)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn.as_matrix(), rng.uniform(-2, 2, 3)
    q = turn.as_quat()
    path = tmp_path / name
    if name == "rows.npy":
        np.save(path, T)
    elif name == "seven.npy":
        np.save(path, np.concatenate((T[:3, 3], q)))
    else:
        path.write_text(FORMS[name](T, q.tolist()))
    np.testing.assert_allclose(load_pose(path), T, atol=1e-9)


EYE = np.eye(4).tolist()
BAD = {
    "rows.json": (json.dumps(EYE[:3]), r"shape \(3, 4\); valid: 4 rows of 4"),
    "ragged.json": (json.dumps([[1], [1, 2]]), "different lengths|no numbers"),
    "text.json": (json.dumps([["a"] * 4] * 4), "no numbers"),
    "cut.json": ("[[1, 0", "no JSON"),
    "keys.yaml": ("pose: 3\n", "keys 'pose' without position; valid"),
    "turn.yaml": ("position: [0, 0, 1]\n", "without quaternion"),
    "list.yaml": ("position: [0, 1]\nquaternion: [0, 0, 0, 1]\n", "position is .*x, y, z"),
    "nan.yaml": ("position: [0, 0, .nan]\nquaternion: [0, 0, 0, 1]\n", "position is"),
    "long.yaml": ("position: [0, 0, 1]\nquaternion: [0, 0, 1, 1]\n", "length 1.414"),
    "twice.yaml": ("position: [0, 0, 1]\nposition: [0, 0, 1]\n", "given twice"),
    "mm.yaml": ("position: [120, 0, 1360]\nquaternion: [0, 0, 0, 1]\n", "millimeters"),
    "left.json": (json.dumps(np.diag([1.0, -1, 1, 1]).tolist()), "left-handed"),
    "pose.txt": ("1 0 0 0", "suffix '.txt'; valid: .json, .yaml, .yml, .npy"),
    "huge.json": (" " * 70_000, "bytes"),
    "damaged.npy": ("no array", "damaged"),
}


@pytest.mark.parametrize("name", BAD)
def test_files_without_a_pose_are_refused_in_one_line(tmp_path: Path, name: str) -> None:
    text, message = BAD[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(CaptureError, match=message) as caught:
        load_pose(tmp_path / name)
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_pickles_in_a_pose_never_run(tmp_path: Path) -> None:
    np.save(tmp_path / "pose.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(CaptureError, match="pickled objects"):
        load_pose(tmp_path / "pose.npy")
    with pytest.raises(CaptureError, match="No such file"):
        load_pose(tmp_path / "gone.npy")


def test_the_option_gives_captures_their_pose_and_leaves_scans_theirs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from boxgrasp.simulate import demo_capture

    view = demo_capture()
    given_pose = {"T_base_camera": view.T_base_camera}
    held = {"depth": view.depth, "intrinsics": view.intrinsics, "target_pixel": view.target_pixel}
    np.savez(tmp_path / "bare.npz", **held)
    np.savez(tmp_path / "own.npz", **held, **given_pose)
    moved = np.array(view.T_base_camera)
    moved[:3, 3] += (0.0, 0.0, 0.25)
    np.save(tmp_path / "pose.npy", moved)
    names = [str(tmp_path / name) for name in ("bare.npz", "own.npz")]
    pose = ["--T-base-camera", str(tmp_path / "pose.npy")]
    assert main(["select", *names, "--json", *pose]) == 0
    bare, own = map(json.loads, capsys.readouterr().out.splitlines())
    assert bare["frame"] == own["frame"] == "given"
    assert bare["T_base_camera"] == own["T_base_camera"] == moved.tolist()
    assert [w["code"] for w in own["warnings"] if "pose" in w["code"]] == ["pose_replaced"]
    assert "pose_replaced" not in {w["code"] for w in bare["warnings"]}
    # A scan without a pose of its own does not get the capture's.
    assert main(["select", names[0], *pose, "--scan", names[0]]) == 2
    assert "a further scan has no T_base_camera" in capsys.readouterr().err
