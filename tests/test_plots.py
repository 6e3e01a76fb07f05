"""Every plot is well-formed, shows as many marks as it was given, and is the same every time."""

import re
import sys
from xml.etree import ElementTree

import numpy as np
import pytest

from boxgrasp.errors import MissingExtraError
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import make_transform
from boxgrasp.grasps.candidates import RIGHT, TOP_PERPENDICULAR
from boxgrasp.ranking import sampling
from boxgrasp.study import plots
from boxgrasp.study.intervals import Estimate, mean, share
from boxgrasp.study.metrics import SCORE_FUNCTIONS
from boxgrasp.study.plots import stages
from boxgrasp.study.plots.stages import BoxPanel, Panel, boxes, clouds
from boxgrasp.study.report import Row

NAMES = ("single-grid", "<cascade> & $grid$")
GRID = {
    "costs": [1.0, 2.0, 4.0],
    "gammas": [0.1, 0.2],
    "accuracies": [[0.1, 0.2, 0.3], [0.4, 0.6, np.nan]],
}
FOUND = {
    "C": 2.0, "gamma": 0.2, "accuracy": 0.6, "coarse": GRID,
    "fine": {**GRID, "costs": [1.5, 2.5, 3.0]},
}  # fmt: skip
NOTHING = mean([])
CLOUD = np.linspace((0.5, -0.2, 0.7), (0.9, 0.2, 1.0), 50, dtype=np.float32)
GRAY = np.full((50, 3), 90, np.uint8)
BOX = Box(make_transform(np.eye(3), (0.7, 0.0, 0.9)), np.array([0.1, 0.05, 0.2]))
BOX_PANEL = BoxPanel(
    title="front, line 2", cluster=CLOUD[20:30], dropped=CLOUD[30:], others=CLOUD[:20], box=BOX,
    exact=BOX, T_base_hand=BOX.T_base_box, half_m=np.array([0.11, 0.08, 0.02]),
)  # fmt: skip
EVERY = {
    "categories": lambda: plots.category_shares(NAMES, ((5, 15, 80), (0, 0, 3))),
    "labels": lambda: plots.label_distribution(np.arange(15).reshape(5, 3)),
    "heat": lambda: plots.heat_map(FOUND, "cascade-grid-side"),
    "scores": plots.score_functions,
    "forest": lambda: plots.forest([Row(name, 0.5, share(3, 9)) for name in NAMES]),
    "rankers": lambda: plots.ranker_points(NAMES, [share(1, 2)] * 2, [share(1, 2), NOTHING]),
    "curves": lambda: plots.curves((1, 10), {NAMES[1]: [share(1, 9)] * 2}, "n", "s", log_x=True),
    "golden": plots.golden_spiral,
    "layers": lambda: plots.spiral_layers(sampling.spiral()),
    "spiral": lambda: plots.samples_3d(sampling.spiral()),
    "dense": lambda: plots.samples_3d(sampling.dense()),
    "clouds": lambda: clouds([Panel("a <b>", CLOUD, GRAY), Panel("c", CLOUD[:9], GRAY[:9])]),
    "boxes": lambda: boxes([BOX_PANEL, BOX_PANEL], from_above=True),
    "boxes-aside": lambda: boxes([BOX_PANEL], from_above=False),
    "portion": lambda: plots.samples_3d(sampling.grid(), sampling.portion(sampling.grid(), RIGHT)),
}
NS = "{http://www.w3.org/2000/svg}"


def groups(svg, prefix):
    """The groups of an SVG whose id starts with a prefix, by id."""
    root = ElementTree.fromstring(svg)
    assert root.tag == f"{NS}svg"
    found = [g for g in root.iter() if g.get("id", "").startswith(prefix)]
    return {g.get("id"): g for g in found}


def marks(group):
    return len(group.findall(f".//{NS}use"))


def center_x(group):
    return float(group.find(f".//{NS}use").get("x"))


def bar_height(group):
    """Height of a bar from its path's corners, in points."""
    ys = re.findall(r"[ML] \S+ (\S+)", group.find(f".//{NS}path").get("d"))
    return max(map(float, ys)) - min(map(float, ys))


@pytest.mark.parametrize("name", EVERY)
def test_a_plot_is_well_formed_small_and_the_same_every_time(name):
    svg = EVERY[name]()
    root = ElementTree.fromstring(svg)
    assert svg == EVERY[name]()
    assert len(svg) < 220_000
    assert "<dc:date>" not in svg and "matplotlib.org" not in svg.split("<defs>", 1)[1]
    for element in root.iter():
        href = element.get("{http://www.w3.org/1999/xlink}href", "#")
        assert href.startswith(("#", "data:image/png;base64"))
        assert not element.tag.endswith("script")


def test_bars_are_as_high_as_their_shares():
    found = groups(plots.category_shares(NAMES, ((5, 15, 80), (0, 0, 3))), "share-")
    assert set(found) == {f"share-{k}-{c}" for k in (0, 1) for c in ("red", "yellow", "green")}
    height = {name: bar_height(group) for name, group in found.items()}
    whole = height["share-1-green"]
    assert height["share-0-red"] == pytest.approx(0.05 * whole, rel=1e-3)
    assert height["share-0-yellow"] == pytest.approx(0.15 * whole, rel=1e-3)
    assert height["share-0-green"] == pytest.approx(0.80 * whole, rel=1e-3)
    assert height["share-1-red"] == 0


def test_a_column_of_no_samples_has_no_bars():
    assert not groups(plots.category_shares(("a",), ((0, 0, 0),)), "share-")


@pytest.mark.parametrize("lines", [1, 3, 7])
def test_there_is_a_bar_for_every_class_and_it_is_as_high_as_its_count(lines):
    counts = np.arange(5 * lines).reshape(5, lines)
    found = groups(plots.label_distribution(counts), "label-")
    assert len(found) == 5 * lines
    tallest = bar_height(found[f"label-{5 * lines}"])
    for label in range(1, 5 * lines + 1):
        expected = tallest * (label - 1) / (5 * lines - 1)
        assert bar_height(found[f"label-{label}"]) == pytest.approx(expected, abs=0.01)


def test_the_chosen_pair_is_outlined_once_where_it_was_tried():
    svg = plots.heat_map(FOUND, "x")
    assert len(groups(svg, "map-")) == 2
    assert svg.count('id="chosen-white"') == 1  # in the coarse grid alone
    both = plots.heat_map({**FOUND, "fine": GRID}, "x")
    assert both.count('id="chosen-white"') == 2


def test_every_score_has_its_curve():
    assert len(groups(plots.score_functions(), "score-")) == len(SCORE_FUNCTIONS)


def test_points_stand_in_the_order_of_their_values_and_missing_ones_not_at_all():
    rows = [
        Row("low", 0.6, Estimate(0.2, 0.1, 0.3, 9)),
        Row("high", 0.4, Estimate(0.8, 0.7, 0.9, 9)),
        Row("missing", 0.5, NOTHING),
        Row("words", "often", share(1, 2)),
    ]
    svg = plots.forest(rows)
    ours, theirs = groups(svg, "ours-"), groups(svg, "thesis-")
    assert set(ours) == {"ours-0", "ours-1", "ours-3"}
    assert set(theirs) == {"thesis-0", "thesis-1", "thesis-2"}
    x = {name: center_x(group) for name, group in (ours | theirs).items()}
    assert x["ours-0"] < x["thesis-1"] < x["thesis-2"] < x["thesis-0"] < x["ours-1"]
    assert x["ours-3"] == pytest.approx(x["thesis-2"])
    assert "nan" not in svg.lower()


def test_rankers_have_a_point_bare_and_one_checked():
    svg = plots.ranker_points(NAMES, [share(1, 2)] * 2, [share(1, 2), NOTHING])
    assert set(groups(svg, "bare-")) == {"bare-0", "bare-1"}
    assert set(groups(svg, "checked-")) == {"checked-0"}
    with pytest.raises(ValueError, match="1 estimates; valid: 2"):
        plots.ranker_points(NAMES, [share(1, 2)], [share(1, 2)] * 2)


def test_curves_have_a_mark_a_value_and_rise_with_it():
    values = [share(10, 100), NOTHING, share(50, 100), share(90, 100)]
    found = groups(
        plots.curves((1, 2, 3, 4), {"a": values, "b": [NOTHING] * 4}, "x", "y"), "curve-"
    )
    uses = found["curve-0"].findall(f".//{NS}use")
    assert len(uses) == 3
    y = [float(use.get("y")) for use in uses]
    assert y[0] - y[1] == pytest.approx(y[1] - y[2], abs=0.02) and y[0] > y[2]
    assert marks(found["curve-1"]) == 0
    with pytest.raises(ValueError, match="series 'a' has 1 values; valid: 2"):
        plots.curves((1, 2), {"a": [share(1, 2)]}, "x", "y")


def test_the_golden_spiral_grows_to_256():
    found = groups(plots.golden_spiral(), "spiral-")
    assert {name: marks(group) for name, group in found.items()} == {
        "spiral-10": 10, "spiral-50": 50, "spiral-100": 100, "spiral-256": 256,
    }  # fmt: skip


@pytest.mark.parametrize(("face", "count"), [(RIGHT, 57), (TOP_PERPENDICULAR, 118)])
def test_views_show_every_sample_and_the_portions_apart(face, count):
    points = sampling.spiral()
    svg = plots.samples_3d(points, sampling.portion(points, face))
    assert {marks(group) for group in groups(svg, "portion-").values()} == {count}
    assert {marks(group) for group in groups(svg, "rest-").values()} == {184}
    whole = groups(plots.samples_3d(points), "from-")
    assert {marks(group) for group in whole.values()} == {184} and len(whole) == 3


def test_a_section_shows_each_layer_s_samples_near_the_plane():
    points = sampling.spiral()
    svg = plots.spiral_layers(points, 0.02)
    assert marks(groups(svg, "layer-4")["layer-4"]) == 98
    near = points[np.abs(points[:, 0]) <= 0.02]
    radii = np.linalg.norm(near, axis=1)
    counts = [int((np.abs(radii - r) < 1e-6).sum()) for r in (0.075, 0.15, 0.225, 0.3)]
    found = groups(svg, "section-")
    assert [marks(found[f"section-{k}"]) for k in (1, 2, 3, 4)] == counts
    assert sum(counts) == len(near) > 10


def test_samples_behind_one_another_are_drawn_once():
    grid = sampling.grid()
    above = groups(plots.samples_3d(grid), "from-above")["from-above"]
    assert marks(above) == len(np.unique(np.round(grid[:, :2], 6), axis=0)) < 184


def test_the_look_is_ours_whatever_matplotlib_is_set_to():
    import matplotlib

    svg = EVERY["forest"]()
    with matplotlib.rc_context({"font.size": 30, "axes.facecolor": "red", "svg.fonttype": "none"}):
        assert EVERY["forest"]() == svg
        assert matplotlib.rcParams["font.size"] == 30


def test_without_matplotlib_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'boxgrasp\[train\]'"):
        plots.golden_spiral()


def test_clouds_are_seen_from_over_the_robots_left_shoulder():
    flat, away = stages._aslant(np.array([(1, 0, 0), (2, 0, 0), (1, 0.5, 0), (1, 0, 0.5)]))
    (_, farther, left, higher), start = flat, flat[0]
    assert away[1] > away[0] > away[3]
    assert farther[1] > start[1] and higher[1] > start[1]
    assert left[0] < start[0] and higher[0] == pytest.approx(start[0])


def test_a_boxs_twelve_edges_are_as_long_as_its_sides():
    corners = stages._corners(BOX)
    lengths = sorted(float(np.linalg.norm(corners[a] - corners[b])) for a, b in stages._EDGES)
    assert lengths == pytest.approx([0.05] * 4 + [0.1] * 4 + [0.2] * 4)
    assert corners.mean(axis=0) == pytest.approx((0.7, 0.0, 0.9))
