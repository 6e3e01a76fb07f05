from __future__ import annotations

import sys
from array import array
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import octomap
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from boxgrasp.errors import BoxgraspError, MapError, MissingExtraError
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.io.octomap import (
    cells_of,
    octomap_cells,
    parse_octomap,
    parse_octomap_body,
    read_octomap,
    write_octomap,
)
from boxgrasp.mapping.local_map import (
    FREE,
    OCCUPIED,
    UNSEEN,
    LocalMap,
    MappingConfig,
    local_map_of,
)
from boxgrasp.mapping.octomap_leaves import map_from_octomap
from boxgrasp.mapping.ray_insertion import build_local_map

QUIET = settings(
    deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
ON_LATTICE = make_transform(np.eye(3), np.array([0.3, -0.3, 0.315]))  # 3 cm cells on multiples


def tree_of(seed: int, resolution: float = 0.05, scans: int = 4, n: int = 400) -> Any:
    """A tree with pruned nodes of several sizes."""
    r = np.random.default_rng(seed)
    tree = octomap.OcTree(resolution)
    for _ in range(scans):
        tree.insertPointCloud(r.normal(0, 0.5, (n, 3)), r.normal(0, 0.2, 3))
    s = resolution
    block = (np.array(list(np.ndindex(8, 8, 8))) + 0.5) * s + 16 * s
    for _ in range(12):
        tree.updateNodes(block, True)
    return tree


def found(tree: Any, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    values, known = np.zeros(len(points), np.float32), np.zeros(len(points), bool)
    for i, point in enumerate(points):
        try:
            values[i] = tree.search(point).getLogOdds()
            known[i] = True
        except octomap.NullPointerException:
            pass
    return values, known


def a_map(T: np.ndarray, seed: int = 0, resolution: float = 0.03) -> LocalMap:
    r = np.random.default_rng(seed)
    points = r.normal(0, 0.2, (3000, 3)).astype(np.float32) + T[:3, 3].astype(np.float32)
    scans = [(points, T[:3, 3] + [-0.6, 0.1, 0.7])] * 2
    return build_local_map(scans, T, MappingConfig(resolution_m=resolution))


@settings(parent=QUIET, max_examples=20)
@given(
    seed=st.integers(0, 10_000),
    resolution=st.sampled_from([0.01, 0.03, 0.05, 0.1, 0.123]),
    binary=st.booleans(),
)
def test_reads_what_octomap_wrote(
    seed: int, resolution: float, binary: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    tree = tree_of(seed, resolution, scans=2, n=100)
    data = tree.writeBinary() if binary else tree.write()
    # writeBinary turned the tree into its most likely one: both sides hold that now.
    path = tmp_path_factory.mktemp("maps") / ("map.bt" if binary else "map.ot")
    path.write_bytes(data)
    cells = read_octomap(path)
    assert cells.resolution_m == resolution
    r = np.random.default_rng(seed)
    points = np.concatenate(
        [r.uniform(-1, 1, (300, 3)), r.uniform(16, 24, (50, 3)) * resolution, [[900.0, 0, 0]]]
    )
    values, known = cells.log_odds_at(points)
    expected, expected_known = found(tree, points[:-1])
    assert not known[-1] and expected_known.sum() > 40
    np.testing.assert_array_equal(known[:-1], expected_known)
    if binary:
        np.testing.assert_array_equal(values[:-1] > 0, expected > 0)
        assert set(np.unique(cells.log_odds)) == {np.float32(-2.000028), np.float32(3.5110307)}
    else:
        np.testing.assert_array_equal(values[:-1], expected)


def test_leaves_are_octomaps_leaves_pruned_ones_too() -> None:
    tree = tree_of(1)
    data = tree.writeBinary()  # prunes
    reread = octomap.OcTree(0.05)
    assert reread.readBinary(data)
    cells = parse_octomap(data)
    leaves = sorted(
        (*np.round(leaf.getCoordinate(), 6), round(leaf.getSize(), 6))
        for leaf in reread.begin_leafs()
    )
    edges = cells.spans * cells.resolution_m
    centers = cells.keys * cells.resolution_m + edges[:, None] / 2
    ours = sorted((*np.round(c, 6), round(e, 6)) for c, e in zip(centers, edges, strict=True))
    np.testing.assert_allclose(ours, leaves, atol=2e-6)
    assert max(cells.spans) >= 8  # the block is one leaf


def test_occupied_cells_are_centers_and_edges_in_the_base_frame() -> None:
    tree = octomap.OcTree(0.1)
    tree.updateNode([0.35, -0.25, 0.05], True)
    tree.updateNode([0.55, -0.25, 0.05], False)
    centers, edges = cells_of(tree).occupied()
    np.testing.assert_allclose(centers, [[0.35, -0.25, 0.05]])
    np.testing.assert_allclose(edges, [0.1])
    assert len(cells_of(tree).occupied(above=0.75)[0]) == 0
    centers, edges = cells_of(tree_of(2).writeBinary()).occupied()
    assert set(np.round(edges / 0.05).astype(int)) >= {1, 8}


@pytest.mark.parametrize("suffix", [".ot", ".bt"])
def test_an_aligned_map_survives_writing_and_reading(tmp_path: Path, suffix: str) -> None:
    for yaw in (0.0, np.pi / 2, np.pi):
        local = a_map(ON_LATTICE @ make_transform(rotation_z(yaw), np.zeros(3)))
        path = tmp_path / f"map{suffix}"
        write_octomap(path, local)
        again = map_from_octomap(cells_of(path), local.T_base_map)
        np.testing.assert_array_equal(again.known, local.known)
        if suffix == ".ot":
            np.testing.assert_array_equal(again.log_odds, local.log_odds)
        else:
            np.testing.assert_array_equal(
                again.log_odds[local.known] > 0, local.log_odds[local.known] >= 0
            )
        if yaw == 0.0:
            theirs = octomap.OcTree.read(str(path)) if suffix == ".ot" else octomap.OcTree(0.03)
            if suffix == ".bt":
                assert theirs.readBinary(path.read_bytes())
            index = np.argwhere(local.known)[::40]
            points = local.centers[tuple(index.T)] + local.T_base_map[:3, 3]
            values, known = found(theirs, points)
            assert known.all() and len(points) > 50
            mine = local.log_odds[tuple(index.T)]
            np.testing.assert_array_equal(values > 0, mine >= 0 if suffix == ".bt" else mine > 0)


def test_a_turned_map_is_resampled_by_less_than_a_cell(tmp_path: Path) -> None:
    T = make_transform(rotation_z(0.4), np.array([0.512, 0.021, 0.777]))
    local = a_map(T)
    write_octomap(tmp_path / "map.ot", local)
    cells = read_octomap(tmp_path / "map.ot")
    centers, edges = cells_of(cells).occupied()
    assert len(centers) > 100 and (edges == 0.03).all()
    back = (centers - T[:3, 3]) @ T[:3, :3]
    # Each cell of the file has the value of the local cell that holds its center.
    assert (local.values_at(back) == 1.0).all()
    again = map_from_octomap(cells_of(cells), T)
    assert (again.state == local.state).mean() > 0.75


def test_an_empty_map_can_be_written_and_read(tmp_path: Path) -> None:
    empty = build_local_map([], np.eye(4))
    for name in ("map.ot", "map.bt"):
        write_octomap(tmp_path / name, empty)
        assert len(read_octomap(tmp_path / name)) == 0
        again = map_from_octomap(cells_of(tmp_path / name), np.eye(4))
        assert not again.known.any()
        assert len(cells_of(tmp_path / name).occupied()[0]) == 0


@settings(parent=QUIET, max_examples=15)
@given(
    seed=st.integers(0, 1000),
    yaw=st.floats(-3, 3),
    theirs=st.sampled_from([0.01, 0.05, 0.1]),
    ours=st.sampled_from([0.05, 0.07]),
)
def test_local_map_samples_a_tree_at_its_cells_centers(
    seed: int, yaw: float, theirs: float, ours: float
) -> None:
    tree = tree_of(seed, theirs, scans=2, n=100)
    T = make_transform(rotation_z(yaw), np.array([0.1, 0.2, 0.0]))
    config = MappingConfig(resolution_m=ours)
    local = map_from_octomap(cells_of(tree), T, config)
    index = np.random.default_rng(seed).integers(0, local.shape, (200, 3))
    centers = local.centers[tuple(index.T)] @ T[:3, :3].T + T[:3, 3]
    values, known = found(tree, centers)
    np.testing.assert_array_equal(local.known[tuple(index.T)], known)
    np.testing.assert_array_equal(local.log_odds[tuple(index.T)], values)


def test_a_file_tells_free_occupied_and_unknown_apart(tmp_path: Path) -> None:
    tree = octomap.OcTree(0.1)
    for _ in range(3):
        tree.updateNode([0.15, 0.05, 0.05], True)
        tree.updateNode([-0.15, 0.05, 0.05], False)
    (tmp_path / "m.bt").write_bytes(tree.writeBinary())
    local = map_from_octomap(cells_of(str(tmp_path / "m.bt")), np.eye(4))
    places = [[0.15, 0.05, 0.05], [-0.15, 0.05, 0.05], [0.0, 0.35, 0.05]]
    assert local.values_at(places).tolist() == [1.0, 0.0, 0.5]
    assert {FREE, UNSEEN, OCCUPIED} == set(np.unique(local.state))


def test_color_trees_and_bodies_without_header_are_read() -> None:
    tree = octomap.ColorOcTree(0.05)
    tree.updateNode([0.12, 0.12, 0.12], True)
    cells = parse_octomap(tree.write())
    np.testing.assert_allclose(cells.occupied()[0], [[0.125, 0.125, 0.125]])
    plain = tree_of(3)
    for binary, data in ((False, plain.write()), (True, plain.writeBinary())):
        body = data[data.index(b"data\n") + 5 :]
        cells = parse_octomap_body(body, 0.05, binary=binary)
        np.testing.assert_array_equal(cells.keys, parse_octomap(data).keys)


def octomap_message(tree: Any, binary: bool, /, **changes: Any) -> SimpleNamespace:
    data = tree.writeBinary() if binary else tree.write()
    fields = {
        "header": SimpleNamespace(frame_id="map"),
        "binary": binary,
        "id": "OcTree",
        "resolution": 0.05,
        "data": data[data.index(b"data\n") + 5 :],
    }
    return SimpleNamespace(**{**fields, **changes})


@pytest.mark.parametrize("binary", [False, True])
def test_octomap_messages_of_every_decoder_are_read(binary: bool) -> None:
    tree = tree_of(4)
    same = parse_octomap(tree.writeBinary() if binary else tree.write())
    body = octomap_message(tree, binary).data
    signed = np.frombuffer(body, np.int8)
    for data in (body, signed, array("b", body), memoryview(body), signed.tolist(), (*signed,)):
        for flag in (binary, np.bool_(binary), int(binary)):
            cells = octomap_cells(octomap_message(tree, binary, data=data, binary=flag))
            np.testing.assert_array_equal(cells.keys, same.keys)
            np.testing.assert_array_equal(cells.log_odds, same.log_odds)
    assert len(octomap_cells(octomap_message(tree, binary, data=b""))) == 0


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"data": None}, "data of type NoneType"),
        ({"data": [1, 2, 300]}, "octomap signed char is greater than maximum"),
        ({"data": ["a"]}, "octomap"),
        ({"data": b"\x00"}, "ends within node"),
        ({"id": "OcTreeBaseless"}, "tree is a 'OcTreeBaseless'"),
        ({"id": 7}, "id of type int"),
        ({"binary": "yes"}, "binary 'yes'; valid: true or false"),
        ({"resolution": 0.0}, "resolution is 0.0 m"),
        ({"resolution": float("nan")}, "resolution is nan m"),
        ({"resolution": "0.05"}, "resolution '0.05'; valid: meters"),
        ({"resolution": 10**400}, "resolution"),
    ],
)
def test_malformed_octomap_messages_are_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(MapError) as caught:
        octomap_cells(octomap_message(tree_of(4), False, **changes))
    assert said in str(caught.value) and str(caught.value).isprintable()


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_octomap_messages_with_any_fields_are_read_or_refused(data: Any) -> None:
    message = octomap_message(tree_of(4, n=10), True)
    kinds = (st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=3))
    anything = st.one_of(*kinds, st.binary(max_size=30), st.lists(st.integers(-200, 200)))
    for _ in range(data.draw(st.integers(1, 2))):
        setattr(message, data.draw(st.sampled_from(sorted(vars(message)))), data.draw(anything))
    if data.draw(st.booleans()):
        delattr(message, data.draw(st.sampled_from(sorted(vars(message)))))
    try:
        octomap_cells(message)
    except MapError as error:
        assert str(error).isprintable()


def header(kind: str = "OcTree", size: int = 1, res: str = "0.05", binary: bool = False) -> bytes:
    first = "# Octomap OcTree binary file" if binary else "# Octomap OcTree file"
    return f"{first}\nid {kind}\nsize {size}\nres {res}\ndata\n".encode()


BAD = {
    "empty": b"",
    "text": b"hello\n",
    "picture": b"\x89PNG\r\n\x1a\n" + bytes(100),
    "no data line": b"# Octomap OcTree file\nid OcTree\nsize 1\nres 0.05\n",
    "no size": b"# Octomap OcTree file\nid OcTree\nres 0.05\ndata\n",
    "size not a number": b"# Octomap OcTree file\nsize many\nres 0.05\ndata\n",
    "other tree": header("CountingOcTree") + bytes(5),
    "resolution 0": header(res="0") + bytes(5),
    "resolution nan": header(res="nan") + bytes(5),
    "resolution negative": header(res="-0.1") + bytes(5),
    "no body": header(),
    "half a node": header() + bytes(3),
    "nan": header() + b"\x00\x00\xc0\x7f\x00",
    "infinite": header() + b"\x00\x00\x80\x7f\x00",
    "too deep": header(size=3_000_000) + b"\0\0\0\0\x01" * 3_000_000,
    "too deep, binary": header(size=100, binary=True) + b"\x03\x00" * 100,
    "too few nodes": header(size=7) + bytes(5),
    "negative size": header(size=-1) + bytes(5),
}


@pytest.mark.parametrize("name", BAD)
def test_broken_files_are_one_line(name: str, tmp_path: Path, capfd: Any) -> None:
    path = tmp_path / "bad.ot"
    path.write_bytes(BAD[name])
    with pytest.raises(MapError) as error:
        read_octomap(path)
    message = str(error.value)
    assert message.startswith(str(path)) and "valid: " in message and "\n" not in message
    out, err = capfd.readouterr()
    assert out == err == ""


@settings(parent=QUIET, max_examples=200)
@given(data=st.data(), binary=st.booleans())
def test_truncated_and_damaged_files_never_do_worse_than_an_error(
    data: st.DataObject, binary: bool
) -> None:
    tree = tree_of(4, scans=1, n=40)
    whole = tree.writeBinary() if binary else tree.write()
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(MapError):
        parse_octomap(whole[:cut])
    broken = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 8))):
        broken[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    try:
        parse_octomap(bytes(broken)).log_odds_at(np.zeros((1, 3)))
    except MapError as error:
        assert "\n" not in str(error)


@settings(parent=QUIET, max_examples=200)
@given(body=st.binary(max_size=300), binary=st.booleans(), size=st.integers(0, 60))
def test_any_bytes_after_a_sound_header(body: bytes, binary: bool, size: int) -> None:
    try:
        parse_octomap(header(size=size, binary=binary) + body)
    except MapError as error:
        assert "\n" not in str(error)


def test_missing_files_folders_and_strange_sources_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="No such file"):
        read_octomap(tmp_path / "none.bt")
    with pytest.raises(MapError, match="cannot be read"):
        read_octomap(tmp_path)
    with pytest.raises(MapError, match="cannot be read"):
        read_octomap("a\0b")
    for source in (None, 3, np.zeros(3)):
        with pytest.raises(MapError, match="valid: a path, bytes, an octomap-python tree"):
            cells_of(source)


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    local = build_local_map([], np.eye(4))
    with pytest.raises(MapError, match=r"suffix is '.txt'; valid: .bt or .ot"):
        write_octomap(tmp_path / "map.txt", local)
    with pytest.raises(MapError, match="cannot be written"):
        write_octomap(tmp_path / "none" / "map.bt", local)
    far = build_local_map([], make_transform(np.eye(3), np.array([5000.0, 0, 0])))
    with pytest.raises(MapError, match="away"):
        write_octomap(tmp_path / "map.bt", far)


def test_reading_works_without_octomap_python_and_writing_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = tree_of(5).write()
    monkeypatch.setitem(sys.modules, "octomap", None)
    assert len(parse_octomap(data)) > 100
    with pytest.raises(MissingExtraError, match=r"install boxgrasp\[io\]$") as error:
        write_octomap(tmp_path / "map.bt", build_local_map([], np.eye(4)))
    assert isinstance(error.value, BoxgraspError)


def test_uncertain_cells_stay_uncertain_in_ot(tmp_path: Path) -> None:
    config = MappingConfig()
    lowest, shape = config.lattice()
    values = np.zeros(shape, np.float32)
    values[3, 3, 3] = 0.25
    known = np.zeros(shape, bool)
    known[:5, :5, :5] = True
    local = local_map_of(values, known, ON_LATTICE, config)
    write_octomap(tmp_path / "map.ot", local)
    again = map_from_octomap(cells_of(tmp_path / "map.ot"), ON_LATTICE)
    np.testing.assert_array_equal(again.known, known)
    np.testing.assert_array_equal(again.log_odds, values)
