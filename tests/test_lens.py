"""Lens distortion undone, held against a camera whose bent rays are worked out here."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from capture_files import write_folder, write_npz
from scipy.optimize import root

from boxgrasp import BoxgraspError, Capture, load_capture
from boxgrasp.errors import CaptureError, MissingExtraError
from boxgrasp.io.lens import Lens, lens_of, undistorted

HEIGHT, WIDTH, FOCAL = 120, 160, 131.0
K = np.array([[FOCAL, 0, 81.0], [0, FOCAL, 58.0], [0, 0, 1]])
LENSES = {
    "plumb_bob": Lens("plumb_bob", (-0.18, 0.04, 0.004, -0.006, 0.0)),
    "rational_polynomial": Lens(
        "rational_polynomial", (0.3, 0.1, 0.001, 0.002, 0.01, 0.45, 0.1, 0.02)
    ),
    "equidistant": Lens("equidistant", (-0.02, 0.01, 0.0, 0.0)),
}
STEP = 0.15  # tangent, half the edge of a nearer square amid a slanted plane


def bent(lens: Lens, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a lens puts a ray's tangents, by its model's textbook formula."""
    r2 = x * x + y * y
    if lens.model == "equidistant":
        r = np.sqrt(r2) + 1e-12
        theta = np.arctan(r)
        k1, k2, k3, k4 = lens.coefficients
        turned = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
        return x * turned / r, y * turned / r
    k1, k2, p1, p2, k3, k4, k5, k6 = (*lens.coefficients, 0.0, 0.0, 0.0)[:8]
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def surfaces(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth, m, and a gray, of the ray with these tangents."""
    far = 1.0 / (1.0 + 0.4 * y + 0.1 * x)
    near = np.maximum(np.abs(x), np.abs(y)) < STEP
    return np.where(near, 0.6, far), 120 + 80 * x + 60 * y


def taken(lens: Lens | None) -> Capture:
    """The view as a camera with this lens takes it, without noise."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    x, y = (u - K[0, 2]) / FOCAL, (v - K[1, 2]) / FOCAL
    if lens is not None:
        goal = np.concatenate((x.ravel(), y.ravel()))

        def off(ray: np.ndarray) -> np.ndarray:
            return np.concatenate(bent(lens, *np.split(ray, 2))) - goal

        solved = root(off, goal, method="df-sane", options={"fatol": 1e-9, "maxfev": 2000})
        assert np.abs(off(solved.x)).max() < 1e-6
        x, y = (half.reshape(HEIGHT, WIDTH) for half in np.split(solved.x, 2))
    depth, gray = surfaces(x, y)
    rgb = np.repeat(np.round(gray)[..., None], 3, axis=2).astype(np.uint8)
    marked = np.maximum(np.abs(x), np.abs(y)) < STEP
    return Capture(depth.astype(np.float32), K, None, rgb, marked, robot_mask=x > 0.45)


IDEAL = taken(None)


@pytest.mark.parametrize("lens", LENSES.values(), ids=str)
def test_a_bent_view_becomes_the_straight_one(lens: Lens) -> None:
    pytest.importorskip("cv2")
    seen = taken(lens)
    raw = np.asarray(seen.depth)
    assert np.mean(np.abs(raw - np.asarray(IDEAL.depth)) > 0.01) > 0.02  # it was bent
    found = undistorted(seen, lens, "camera")
    depth, ideal = np.asarray(found.depth), np.asarray(IDEAL.depth)
    shown = depth > 0
    assert shown.mean() > 0.9
    # Every depth was measured: none lies between the two surfaces.
    assert np.isin(depth[shown], raw).all()
    off = np.abs(depth - ideal)[shown]
    assert np.mean(off > 0.004) < 0.02 and np.median(off) < 0.002  # edges move by half a pixel
    assert found.mask is not None and IDEAL.mask is not None
    assert np.count_nonzero(found.mask != IDEAL.mask) <= 0.6 * 4 * 2 * STEP * FOCAL
    assert found.robot_mask is not None and IDEAL.robot_mask is not None
    assert np.count_nonzero((found.robot_mask != IDEAL.robot_mask)[shown]) <= 2 * HEIGHT
    assert found.rgb is not None and IDEAL.rgb is not None
    inner = shown.copy()
    inner[[0, -1]] = inner[:, [0, -1]] = False
    gray = found.rgb.astype(int)[..., 0] - IDEAL.rgb[..., 0]
    assert np.percentile(np.abs(gray[inner]), 99) <= 1
    np.testing.assert_array_equal(found.intrinsics, K)
    (warning,) = found.warnings
    assert warning.code == "lens_undistorted" and "pixels" in warning.message


def test_a_pixel_goes_where_its_thing_goes() -> None:
    pytest.importorskip("cv2")
    lens = LENSES["plumb_bob"]
    seen = taken(lens)
    x, y = 0.45, -0.3
    u, v = (float(axis) for axis in bent(lens, np.array(x), np.array(y)))
    pixel = (round(u * FOCAL + K[0, 2]), round(v * FOCAL + K[1, 2]))
    found = undistorted(Capture(seen.depth, K, target_pixel=pixel), lens, "camera").target_pixel
    straight = (x * FOCAL + K[0, 2], y * FOCAL + K[1, 2])
    assert found is not None and np.abs(np.subtract(found, straight)).max() <= 1.0
    assert np.abs(np.subtract(pixel, straight)).max() > 2.0  # so that it had to move


def test_the_map_of_a_camera_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    cv2 = pytest.importorskip("cv2")
    calls = []
    made = cv2.initUndistortRectifyMap
    monkeypatch.setattr(
        cv2, "initUndistortRectifyMap", lambda *given: calls.append(1) or made(*given)
    )
    lens = Lens("plumb_bob", (0.0777, 0.0, 0.0, 0.0))
    for _ in range(3):
        undistorted(IDEAL, lens, "camera")
    assert len(calls) == 1


def test_strong_distortion_is_refused_and_a_trace_of_it_changes_nothing() -> None:
    pytest.importorskip("cv2")
    for lens in (
        Lens("plumb_bob", (-1.0, 0.0, 0.0, 0.0)),  # folds the image
        Lens("plumb_bob", (1.5, 0.0, 0.0, 0.0)),
        Lens("equidistant", (-0.9, 0.0, 0.0, 0.0)),
    ):
        with pytest.raises(CaptureError, match="strong lens distortion.*valid: a rectified"):
            undistorted(IDEAL, lens, "camera")
    assert undistorted(IDEAL, Lens("plumb_bob", (1e-4, 0, 0, 0)), "camera") is IDEAL


def test_lenses_that_are_none_or_unknown() -> None:
    assert lens_of("", [0.0, 0.0], "camera") is None
    assert lens_of("anything", [], "camera") is None
    for model, numbers, message in (
        ("inverse_brown_conrady", [0.1] * 5, "model 'inverse_brown_conrady'.*rectified"),
        ("plumb_bob", [0.1], r"distortion \[0.1\].*rectified.*4, 5, 8, 12, 14"),
        ("equidistant", [0.1] * 5, "4 finite numbers"),
        ("", [0.1, np.nan, 0, 0], "finite"),
    ):
        with pytest.raises(CaptureError, match=message):
            lens_of(model, numbers, "camera")


def test_without_opencv_one_line_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    folder = written(tmp_path, {"D": [0.1, 0, 0, 0]})
    with pytest.raises(MissingExtraError, match=r"boxgrasp\[lens\].*rectified") as caught:
        load_capture(folder)
    assert str(folder) in str(caught.value) and "\n" not in str(caught.value)


def written(tmp_path: Path, told: dict[str, object]) -> Path:
    """A folder of a small view whose camera tells of a lens."""
    from capture_files import view

    folder = write_folder(tmp_path / f"view{len(list(tmp_path.iterdir()))}", view())
    camera = json.loads((folder / "intrinsics.json").read_text())
    (folder / "intrinsics.json").write_text(json.dumps({**camera, **told}))
    return folder


def test_folders_and_archives_undo_it_alike(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    from capture_files import view

    values = [0.1, -0.02, 0.003, 0.004, 0.01]
    names = dict(zip(("k1", "k2", "p1", "p2", "k3"), values, strict=True))
    npz = write_npz(tmp_path / "view.npz", view(), distortion=np.array(values))
    straight = load_capture(npz)
    assert [w.code for w in straight.warnings] == ["lens_undistorted"]
    assert (np.asarray(straight.depth) != view().depth).any()
    for told in (
        {"D": values},
        {"distortion": names},
        {"distortion_coefficients": {"rows": 1, "cols": 5, "data": values}},
        {"coeffs": values, "distortion_model": "plumb_bob"},
        names,
    ):
        found = load_capture(written(tmp_path, told))
        np.testing.assert_allclose(np.asarray(found.depth), straight.depth, atol=6e-4)
        np.testing.assert_array_equal(found.mask, straight.mask)


def test_folders_whose_lens_is_unclear_are_refused(tmp_path: Path) -> None:
    for told, message in (
        ({"k1": 0.1, "D": [0.1, 0, 0, 0]}, "rectified"),
        ({"k1": 0.1, "k4": 0.1}, "distortion_model"),
        ({"coeffs": [[0.1]]}, "coeffs.*rectified"),
        ({"D": [0, 0, -1e-3]}, "D has lens distortion.*rectified"),
        ({"p2": float("nan")}, "p2.*rectified"),
        ({"distortion": {"s1": 0.2}}, "distortion.*rectified"),
        ({"distortion": "strong", "k1": 1e9, "k2": "x"}, "rectified"),
    ):
        with pytest.raises(BoxgraspError, match=message):
            load_capture(written(tmp_path, told))
