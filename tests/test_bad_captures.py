"""Whatever a file holds, it loads, or says in one line why not; nothing in it is run."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from capture_files import HEIGHT, WIDTH, pcd_bytes, ply_bytes, view, write_folder, write_npz
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from boxgrasp import load_capture
from boxgrasp.errors import BoxgraspError, CaptureError

SEEN = view()
FLAT = SEEN.points[np.isfinite(SEEN.points[..., 0])]


class Bomb:
    """Unpickling it makes a folder."""

    def __reduce__(self):
        return os.mkdir, ("unpickled",)


def npz(**changes) -> Callable[[Path], Path]:
    return lambda folder: write_npz(folder / "view.npz", SEEN, **changes)


def file(name: str, data: bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return write


def npz_of(**members: bytes) -> Callable[[Path], Path]:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return file("view.npz", held.getvalue())


def npy(array: np.ndarray, **header) -> bytes:
    held = io.BytesIO()
    np.save(held, array, allow_pickle=True)
    data = held.getvalue()
    for old, new in header.items():
        data = data.replace(old.encode(), new.encode())
    return data


def huge_npy() -> bytes:
    head = b"{'descr': '<f4', 'fortran_order': False, 'shape': (1000000, 1000000), }"
    head = head.ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + bytes(64)


def folder(change: Callable[[Path], object]) -> Callable[[Path], Path]:
    def write(parent: Path) -> Path:
        made = write_folder(parent / "view", SEEN)
        change(made)
        return made

    return write


def camera(**changes) -> Callable[[Path], Path]:
    def change(made: Path) -> None:
        found = json.loads((made / "intrinsics.json").read_text())
        kept = {k: v for k, v in {**found, **changes}.items() if v is not None}
        (made / "intrinsics.json").write_text(json.dumps(kept))

    return folder(change)


def told(text: str) -> Callable[[Path], Path]:
    return folder(lambda made: (made / "capture.json").write_text(text))


def image(name: str, pixels: np.ndarray) -> Callable[[Path], Path]:
    return folder(lambda made: Image.fromarray(pixels).save(made / name))


def bomb_png(width: int, height: int) -> bytes:
    """A PNG whose header claims a size that its few bytes do not hold."""
    held = io.BytesIO()
    Image.fromarray(np.zeros((1, 1), np.uint16)).save(held, "PNG")
    data = bytearray(held.getvalue())
    data[16:24] = width.to_bytes(4, "big") + height.to_bytes(4, "big")
    import zlib

    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    return bytes(data)


def cut(name: str) -> Callable[[Path], Path]:
    def change(made: Path) -> None:
        data = (made / name).read_bytes()
        (made / name).write_bytes(data[: len(data) // 2])

    return folder(change)


def pcd(old: str = "", new: str = "", encoding: str = "binary", **options) -> Callable:
    data = pcd_bytes(FLAT, encoding, **options)
    assert old.encode() in data
    return file("cloud.pcd", data.replace(old.encode(), new.encode(), 1))


def ply(old: str = "", new: str = "", encoding: str = "binary_little_endian") -> Callable:
    data = ply_bytes(FLAT, encoding)
    assert old.encode() in data
    return file("cloud.ply", data.replace(old.encode(), new.encode(), 1))


PCD, PLY = pcd_bytes(FLAT, "binary"), ply_bytes(FLAT, "ascii")
LZF = pcd_bytes(FLAT, "binary_compressed")
LZF_AT = LZF.index(b"binary_compressed\n") + 18
N = len(FLAT)
mkdir = Path.mkdir

BAD: dict[str, tuple[Callable[[Path], Path], str]] = {
    "missing": (lambda f: f / "none.npz", "no such file"),
    "missing without suffix": (lambda f: f / "none", "no such file"),
    "suffix": (file("view.txt", b"1 2 3"), r"'.txt'; valid: .npz, .pcd, .ply, .bag, .db3, .mcap"),
    "no suffix": (file("view", b"1 2 3"), "no suffix; valid"),
    "a pipe": (lambda f: (os.mkfifo(f / "a.npz"), f / "a.npz")[1], "no regular file"),
    "empty folder": (lambda f: f, "without depth.png"),
    "folder named .npz": (lambda f: ((f / "a.npz").mkdir(), f / "a.npz")[1], "without depth"),
    "name of two lines": (lambda f: f / "no\nsuch\x1b[31m.npz", r"no such \[31m\.npz: no such"),
    # npz
    "npz empty": (file("view.npz", b""), "damaged"),
    "npz no zip": (file("view.npz", b"depth" * 99), "not a zip"),
    "npz is an npy": (file("view.npz", npy(SEEN.depth)), "not a zip"),
    "npz without depth": (npz(depth=None), "valid: depth, intrinsics"),
    "npz without intrinsics": (npz(intrinsics=None), "valid: depth, intrinsics"),
    "npz of objects": (npz(depth=np.array([Bomb()], dtype=object)), "pickled objects"),
    "npz pickle beside": (npz(rgb=np.array(Bomb(), dtype=object)), "rgb holds pickled"),
    "npz bare pickle": (npz_of(depth=b"cos\nmkdir\n(S'unpickled'\ntR.", intrinsics=b""), "magic"),
    "npz huge": (npz_of(depth=huge_npy(), intrinsics=npy(SEEN.intrinsics)), "truncated"),
    "npz short": (npz_of(depth=npy(SEEN.depth)[:-9], intrinsics=b""), "truncated"),
    "npz negative": (
        npz_of(depth=npy(SEEN.depth, **{"(24, 32)": "(-4, -8)"}), intrinsics=b""),
        "bytes for shape",
    ),
    "npz structured": (npz(depth=np.zeros(3, "f4,f4")), "valid: .height, width"),
    "npz text": (npz(depth=np.array("depth")), "depth holds <U5"),
    "npz uint16": (npz(depth=(SEEN.depth * 1000).astype(np.uint16)), "divide millimeters"),
    "npz millimeters": (npz(depth=SEEN.depth * 1000), "millimeters"),
    "npz missing everywhere": (npz(depth=SEEN.depth * 0), "missing at every pixel"),
    "npz intrinsics": (npz(intrinsics=SEEN.intrinsics * np.nan), "NaN"),
    "npz pose": (npz(T_base_camera=np.diag([1.0, 1, -1, 1])), "mirrored"),
    "npz mask": (npz(mask=SEEN.mask[1:]), "mask has shape"),
    "npz pixel": (npz(target_pixel=np.array([640, 3])), "outside"),
    # folder
    "no intrinsics": (folder(lambda f: (f / "intrinsics.json").unlink()), "s.json is missing"),
    "intrinsics cut": (cut("intrinsics.json"), "intrinsics.json is no JSON"),
    "intrinsics list": (folder(lambda f: (f / "intrinsics.json").write_text("[1]")), "no object"),
    "intrinsics deep": (
        folder(lambda f: (f / "intrinsics.json").write_text("[" * 100_000)),
        "no JSON",
    ),
    "intrinsics large": (
        folder(lambda f: (f / "intrinsics.json").write_text(" " * 2_000_000)),
        "over 1048576 bytes",
    ),
    "intrinsics latin": (
        folder(lambda f: (f / "intrinsics.json").write_bytes(b'{"\xe9": 1}')),
        "no JSON",
    ),
    "fx missing": (camera(fx=None), "lacks fx; valid: fx, fy, cx, cy, width, height"),
    "width missing": (camera(width=None), "lacks width"),
    "fx text": (camera(fx="30"), "no finite number as fx"),
    "fx true": (camera(fx=True), "no finite number as fx"),
    "fx NaN": (camera(fx=float("nan")), "no finite number as fx"),
    "fx huge": (camera(fx=10**400), "no finite number as fx"),
    "fx negative": (camera(fx=-30.0), "fx = -30"),
    "cx far": (camera(cx=9000), "cx = 9000"),
    "distorted": (camera(coeffs=[[0.1]]), "rectified"),
    "another size": (camera(width=WIDTH + 1), "32 x 24 pixels; valid: 33 x 24"),
    "half a pixel": (camera(width=WIDTH + 0.5), "whole pixels"),
    "depth cut": (cut("depth.png"), "truncated|damaged"),
    "depth no png": (folder(lambda f: (f / "depth.png").write_bytes(b"x" * 99)), "or no PNG"),
    "depth jpeg": (folder(lambda f: (f / "color.png").rename(f / "depth.png")), "mode RGB"),
    "depth 8 bit": (image("depth.png", (SEEN.depth * 200).astype(np.uint8)), "valid: 16 bit"),
    "depth zero": (image("depth.png", np.zeros((HEIGHT, WIDTH), np.uint16)), "every pixel"),
    "depth a folder": (
        folder(lambda f: ((f / "depth.png").unlink(), mkdir(f / "depth.png"))),
        "depth.png is no file",
    ),
    "depth bomb": (
        folder(lambda f: (f / "depth.png").write_bytes(bomb_png(100_000, 100_000))),
        "100000 x 100000|too large",
    ),
    "depth bomb that fits": (
        lambda f: (
            camera(width=100_000, height=100_000)(f),
            (f / "view/depth.png").write_bytes(bomb_png(100_000, 100_000)),
            f / "view",
        )[2],
        "at most",
    ),
    "depth bomb of a middle size": (
        lambda f: (
            camera(width=9_000, height=8_000)(f),
            (f / "view/depth.png").write_bytes(bomb_png(9_000, 8_000)),
            f / "view",
        )[2],
        "9000 x 8000 pixels; valid: at most",
    ),
    "color cut": (cut("color.png"), "truncated|damaged"),
    "color size": (image("color.png", SEEN.rgb[:-1]), "color.png is 32 x 23"),
    "mask size": (image("mask.png", np.ones((HEIGHT, 3), np.uint8)), "mask.png is 3 x 24"),
    "mask empty": (image("mask.png", np.zeros((HEIGHT, WIDTH), np.uint8)), "mask is empty"),
    "capture.json cut": (told('{"T_base'), "capture.json is no JSON"),
    "capture.json scale": (told('{"depth_scale": 1000}'), "meters a unit"),
    "capture.json scale 0": (told('{"depth_scale": 0}'), "meters a unit"),
    "capture.json scale NaN": (told('{"depth_scale": NaN}'), "meters a unit"),
    "capture.json scale text": (told('{"depth_scale": "mm"}'), "meters a unit"),
    "capture.json pose": (told('{"T_base_camera": [[1, 0], [0, 1]]}'), "T_base_camera has shape"),
    "capture.json ragged": (told('{"T_base_camera": [[1, 0], [0]]}'), "T_base_camera is not num"),
    "capture.json pose text": (told('{"T_base_camera": {"a": 1}}'), "T_base_camera is not num"),
    "capture.json pixel": (told('{"target_pixel": [99, 1]}'), "outside"),
    "capture.json pixel text": (told('{"target_pixel": "middle"}'), "target_pixel"),
    # pcd
    "pcd empty": (file("cloud.pcd", b""), "no DATA line"),
    "pcd text": (file("cloud.pcd", b"hello\n" * 99), "no DATA line"),
    "pcd binary": (file("cloud.pcd", bytes(range(256)) * 9), "no text|not text"),
    "pcd no points": (file("cloud.pcd", pcd_bytes(FLAT[:0], "binary")), "cloud is empty"),
    "pcd all NaN": (file("cloud.pcd", pcd_bytes(FLAT * np.nan, "ascii")), "no valid point"),
    "pcd cut": (file("cloud.pcd", PCD[:-5]), "truncated"),
    "pcd cut by points": (file("cloud.pcd", PCD[:-24]), "truncated"),
    "pcd cut text": (pcd(encoding="ascii", old=f"POINTS {N}", new="POINTS 99999"), "for"),
    "pcd cut packed": (file("cloud.pcd", LZF[:-5]), "truncated"),
    "pcd packed sizes": (
        file("cloud.pcd", LZF[: LZF_AT + 4] + b"\xff\xff\xff\x7f" + LZF[LZF_AT + 8 :]),
        "unpacks to 2147483647",
    ),
    "pcd packed noise": (file("cloud.pcd", LZF[: LZF_AT + 8] + b"\xff" * len(LZF)), "damaged"),
    "pcd huge": (
        file(
            "cloud.pcd",
            PCD.replace(b"WIDTH %d" % N, b"WIDTH 1000000000000").replace(
                b"POINTS %d" % N, b"POINTS 1000000000000"
            ),
        ),
        "claims 1000000000000 points",
    ),
    "pcd product": (pcd(f"WIDTH {N}", "WIDTH 7"), "valid: their product"),
    "pcd negative": (pcd("HEIGHT 1", "HEIGHT -1"), "valid: their product"),
    "pcd no number": (pcd("HEIGHT 1", "HEIGHT one"), "whole numbers"),
    "pcd fields": (pcd("FIELDS x y z", "FIELDS x y w"), "valid: x y z once each"),
    "pcd twice": (pcd("FIELDS x y z", "FIELDS x y y"), "valid: x y z once each"),
    "pcd lengths": (pcd("SIZE 4 4 4", "SIZE 4 4"), "differ in length"),
    "pcd integers": (pcd("TYPE F F F", "TYPE F F I"), "z is no single float"),
    "pcd size": (pcd("SIZE 4 4 4", "SIZE 4 4 3"), "damaged|truncated"),
    "pcd count": (pcd("COUNT 1 1 1", "COUNT 1 1 999999999"), "no single float"),
    "pcd data": (pcd("DATA binary", "DATA zipped"), "valid: ascii, binary, binary_compressed"),
    "pcd viewpoint": (pcd(viewpoint="0 0 0 0 0 0 0"), "quaternion"),
    "pcd viewpoint NaN": (pcd(viewpoint="nan 0 0 1 0 0 0"), "seven numbers"),
    "pcd viewpoint short": (pcd(viewpoint="0 0 0 1"), "seven numbers"),
    "pcd words": (file("cloud.pcd", PCD[: PCD.index(b"DATA")] + b"DATA ascii\n"
                       + b"a b c\n" * N), "damaged"),
    "pcd millimeters": (file("cloud.pcd", pcd_bytes(FLAT * 1000, "binary")), "millimeters"),
    "pcd behind": (file("cloud.pcd", pcd_bytes(-FLAT, "binary")), "behind the camera"),
    # ply
    "ply empty": (file("cloud.ply", b""), "no end_header"),
    "ply cut": (file("cloud.ply", PLY[: len(PLY) // 2]), "truncated|damaged|header says"),
    "ply cut binary": (file("cloud.ply", ply_bytes(FLAT, "binary_big_endian")[:-99]), "truncated"),
    "ply huge": (ply(f"vertex {N}", "vertex 1000000000000"), "claims 1000000000000 points"),
    "ply huge before": (ply("stamp 2", "stamp 999999999999"), "truncated"),
    "ply none": (ply(f"vertex {N}", "vertex 0"), "cloud is empty"),
    "ply negative": (ply(f"vertex {N}", "vertex -5"), "PLY header has"),
    "ply magic": (ply("ply\n", "plx\n"), "does not start with"),
    "ply format": (ply("binary_little_endian", "binary_middle_endian"), "PLY header has"),
    "ply type": (ply("double nx", "quad nx"), "PLY header has"),
    "ply no z": (ply("float z", "float w"), "valid: x y z"),
    "ply whole numbers": (ply("float z", "int z"), "whole numbers"),
    "ply faces first": (ply("int seconds", "list uchar int ids"), "vertices first"),
    "ply no vertex": (ply("element vertex", "element vortex"), "no element vertex"),
    "ply words": (ply("\n7\n8\n", "\n7\n8\na b c d\n", "ascii"), "damaged"),
    # bags
    "bag empty": (file("view.bag", b""), "damaged"),
    "bag noise": (file("view.bag", b"#ROSBAG V2.0\n" + bytes(99)), "damaged"),
    "mcap empty": (file("view.mcap", b""), "damaged"),
    "mcap noise": (file("view.mcap", b"\x89MCAP0\r\n" + bytes(99)), "damaged"),
    "db3 noise": (file("view.db3", b"SQLite format 3\0" + bytes(999)), "damaged"),
    "db3 empty": (file("view.db3", b""), "damaged"),
    "ros 2 folder": (lambda f: (file("metadata.yaml", b"a: [")(f), f)[1], "damaged"),
    "ros 2 tags": (
        lambda f: (file("metadata.yaml", b"!!python/object/apply:os.mkdir [unpickled]")(f), f)[1],
        "damaged",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_file_is_refused_in_one_line(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write, message = BAD[name]
    if name.split()[0] in ("bag", "mcap", "db3", "ros"):
        pytest.importorskip("rosbags")
    path = write(tmp_path)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        with pytest.raises(CaptureError, match=message) as caught:
            load_capture(path)
    said = str(caught.value)
    assert len(said.splitlines()) == 1 and said.isprintable()
    assert said.startswith(str(tmp_path))
    assert not [str(w.message) for w in warned]
    assert not (tmp_path / "unpickled").exists()


def test_unreadable_place_is_refused_in_one_line(tmp_path, monkeypatch):
    def deny(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "listdir", deny)
    with pytest.raises(CaptureError, match="cannot be read: Permission denied"):
        load_capture(tmp_path)


def test_unknown_cloud_frame_is_refused(tmp_path):
    with pytest.raises(CaptureError, match="'world'; valid: optical, base"):
        load_capture(npz()(tmp_path), cloud_frame="world")


def test_claims_take_no_memory(tmp_path):
    names = ("pcd huge", "ply huge", "npz huge", "pcd packed sizes", "depth bomb that fits")
    tracemalloc.start()
    for name in names:
        (tmp_path / name).mkdir()
        path = BAD[name][0](tmp_path / name)
        with pytest.raises(CaptureError):
            load_capture(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 30e6


def valid_files(folder: Path) -> dict[str, bytes]:
    """Suffix and what to call it, and the bytes of a valid capture."""
    found = {
        ".npz": write_npz(folder / "view.npz", SEEN).read_bytes(),
        "ascii.pcd": pcd_bytes(FLAT[:50], "ascii", rgb=SEEN.rgb.reshape(-1, 3)[:50], rgb_type="U"),
        "binary.pcd": pcd_bytes(FLAT[:50], "binary"),
        "packed.pcd": pcd_bytes(FLAT[:50], "binary_compressed"),
        "ascii.ply": ply_bytes(FLAT[:50], "ascii", rgb=SEEN.rgb.reshape(-1, 3)[:50]),
        "binary.ply": ply_bytes(FLAT[:50], "binary_big_endian"),
    }
    made = write_folder(folder / "images", SEEN)
    for name in ("depth.png", "color.png", "mask.png", "intrinsics.json", "capture.json"):
        found[name] = (made / name).read_bytes()
    try:
        from bag_files import depth_bag
    except ImportError:
        return found
    for kind, name in (("ros1", "ros1.bag"), ("db3", "ros2.db3"), ("mcap", "ros2.mcap")):
        found[name] = depth_bag(kind, SEEN).write(folder).read_bytes()
    return found


class Valid:
    """Files to damage; not a tuple, since hypothesis prints its arguments."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.files = folder, valid_files(folder)


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    return Valid(tmp_path_factory.mktemp("valid"))


def load_or_say(folder: Path, name: str, data: bytes) -> None:
    if name.endswith((".png", ".json")):
        path, file_path = folder / "images", folder / "images" / name
    else:
        path = file_path = folder / f"fuzz{name}"
    kept = file_path.read_bytes() if file_path.exists() else None
    file_path.write_bytes(data)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            try:
                capture = load_capture(path)
            except BoxgraspError as error:
                assert len(str(error).splitlines()) == 1 and str(path) in str(error)
            else:
                points, pixels = capture.valid_points()
                assert np.isfinite(points).all() and len(points) == len(pixels)
        assert not [str(w.message) for w in warned if w.category is not ResourceWarning]
    finally:
        if kept is not None:
            file_path.write_bytes(kept)


NAMES = (
    ".npz", "ascii.pcd", "binary.pcd", "packed.pcd", "ascii.ply", "binary.ply", "depth.png",
    "color.png", "mask.png", "intrinsics.json", "capture.json", "ros1.bag", "ros2.db3", "ros2.mcap",
)  # fmt: skip
quick = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.mark.parametrize("name", NAMES)
@quick
@given(data=st.data())
def test_damaged_files_load_or_say_why(name, valid, data):
    folder, files = valid.folder, valid.files
    if name not in files:
        pytest.skip("rosbags is not installed")
    damaged = bytearray(files[name])
    head = min(len(damaged), 600)  # headers are where damage tells
    places = st.one_of(st.integers(0, head - 1), st.integers(0, len(damaged) - 1))
    for place, value in data.draw(
        st.lists(st.tuples(places, st.integers(0, 255)), max_size=6), label="changes"
    ):
        damaged[place] = value
    if data.draw(st.booleans(), label="cut"):
        del damaged[data.draw(places, label="at") :]
    load_or_say(folder, name, bytes(damaged))


@pytest.mark.parametrize("name", NAMES)
@settings(parent=quick, max_examples=25)
@given(noise=st.binary(max_size=400), keep=st.integers(0, 300))
def test_noise_after_a_valid_start_loads_or_says_why(name, valid, noise, keep):
    folder, files = valid.folder, valid.files
    if name not in files:
        pytest.skip("rosbags is not installed")
    load_or_say(folder, name, files[name][:keep] + noise)


_BIG = """
import resource, sys, time
import numpy as np
from boxgrasp import load_capture
path, count = sys.argv[1], int(sys.argv[2])
start = time.perf_counter()
capture = load_capture(path)
points, _ = capture.valid_points()
assert len(points) == count, len(points)
print(time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6)
"""


@pytest.mark.slow
def test_ten_million_points_load_in_time_and_memory(tmp_path):
    count = 10_000_000
    points = np.random.default_rng(0).random((count, 3), np.float32) + np.float32(0.4)
    head, _ = pcd_bytes(points[:3], "binary").split(b"DATA binary\n")
    for key in (b"WIDTH", b"POINTS"):
        head = head.replace(key + b" 3", key + b" %d" % count)
    path = tmp_path / "cloud.pcd"
    with path.open("wb") as stream:
        stream.write(head + b"DATA binary\n")
        points.tofile(stream)
    run = subprocess.run(
        [sys.executable, "-c", _BIG, str(path), str(count)],
        check=True,
        timeout=60,
        capture_output=True,
        text=True,
    )
    seconds, gigabytes = map(float, run.stdout.split())
    assert seconds < 25 and gigabytes < 3
