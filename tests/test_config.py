"""The configuration: strict at every depth, one line a mistake, one hash for the same values."""

from __future__ import annotations

import dataclasses
import typing
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxgrasp.config import Config, config_hash, dump_config, load_config, load_gripper
from boxgrasp.errors import BoxgraspError, ConfigError, GripperError
from boxgrasp.strict import build, describe, to_yaml


def sections(kind: type, place: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], type]]:
    """Every dataclass of the configuration with the keys that lead to it."""
    found = [(place, kind)]
    for name, hint in typing.get_type_hints(kind).items():
        if dataclasses.is_dataclass(hint):
            found += sections(hint, (*place, name))
    return found


def nest(place: tuple[str, ...], leaf: dict[str, object]) -> dict[str, object]:
    for name in reversed(place):
        leaf = {name: leaf}
    return leaf


SECTIONS = sections(Config)
LEAVES = [
    (place, field.name)
    for place, kind in SECTIONS
    for field in dataclasses.fields(kind)
    if not dataclasses.is_dataclass(typing.get_type_hints(kind)[field.name])
]


def one_line(error: pytest.ExceptionInfo[BoxgraspError]) -> str:
    text = str(error.value)
    assert "\n" not in text and len(text) < 1000
    return text


def test_nothing_said_is_the_default() -> None:
    assert load_config() == load_config({}) == load_config(Config()) == Config()


def test_dump_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(dump_config(Config()))
    assert load_config(path) == load_config(str(path)) == Config()


def test_empty_sections_are_defaults(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("gripper:\n")
    assert load_config(path) == Config()


@pytest.mark.parametrize(("place", "kind"), SECTIONS, ids=str)
def test_unknown_key_is_refused_at_every_depth(place: tuple[str, ...], kind: type) -> None:
    names = [field.name for field in dataclasses.fields(kind)]
    wrong = names[0][:-1] + "X" if len(names[0]) > 2 else names[0] + "X"
    with pytest.raises(ConfigError) as error:
        load_config(nest(place, {wrong: 1}))
    text = one_line(error)
    assert repr(wrong) in text and names[-1] in text and f"did you mean {names[0]}?" in text
    assert not place or f"in {'.'.join(place)};" in text


RENAMED = {
    (): {
        "options": "candidates",
        "occupancy": "mapping",
        "check": "checks",
        "chooser": "ranker",
    },
    ("scene",): {
        "near_m": "min_range_m",
        "far_m": "max_range_m",
        "cluster_m": "cluster_tolerance_m",
        "lowest_m": "min_height_m",
        "highest_m": "max_height_m",
        "outlier_neighbours": "outlier_nb_neighbors",
        "outlier_sigma": "outlier_std_ratio",
        "least_points": "min_cluster_size",
    },
    ("mapping",): {
        "hit": "prob_hit",
        "miss": "prob_miss",
        "thin": "stride",
        "centre_above_support_m": "center_above_support_m",
    },
    ("checks",): {
        "clearance_m": "visible_clearance_m",
        "noise_m": "noise_gain",
        "noise_margin_m": "noise_gain",
        "body_m": "occluded_clearance_m",
        "unseen_m": "unseen_distance_m",
        "unseen_share": "unseen_fraction",
        "approach_back_m": "pregrasp_distance_m",
        "approach_m": "approach_clearance_m",
        "support_m": "plane_clearance_m",
        "width_m": "noise_gain",
        "width_margin_m": "noise_gain",
    },
    ("gripper",): {"reach_past_face_m": "insertion_depth_m"},
}
OLD_NAMES = [(place, old, new) for place, names in RENAMED.items() for old, new in names.items()]


@pytest.mark.parametrize(("place", "old", "new"), OLD_NAMES, ids=str)
def test_an_old_name_is_refused_with_the_new_one(
    place: tuple[str, ...], old: str, new: str, tmp_path: Path
) -> None:
    """From Python, from YAML, and beside the new name."""
    path = tmp_path / "c.yaml"
    where = f" in {'.'.join(place)}" if place else ""
    for leaf in ({old: 0.1}, {new: {}, old: 0.1}):
        path.write_text(to_yaml(nest(place, dict(leaf))))
        for source in (nest(place, dict(leaf)), path):
            with pytest.raises(ConfigError) as error:
                load_config(source)
            assert f"{old!r}{where} is now {new!r}" in one_line(error)


def test_every_old_name_leads_to_a_name_that_is_read() -> None:
    kinds = dict(SECTIONS)
    for place, old, new in OLD_NAMES:
        names = {field.name for field in dataclasses.fields(kinds[place])}
        assert new in names and old not in names


@pytest.mark.parametrize(("old", "new"), RENAMED["gripper",].items(), ids=str)
def test_an_old_name_in_a_gripper_file(old: str, new: str, tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    path.write_text(f"{old}: 0.05")
    with pytest.raises(GripperError, match=f"'{old}' is now '{new}'") as error:
        load_gripper(path)
    assert str(path) in one_line(error)


@pytest.mark.parametrize(
    ("plugins", "said"),
    [
        ({"a": 1}, "checks.plugins is a section; valid: a section, each entry a section"),
        (1, "checks.plugins is 1; valid: a section, each entry a section"),
        ({"a": {"b": float("nan")}}, "checks.plugins.a.b is nan; valid: a finite number, text"),
        ({"a": {"b": [1, {1}]}}, "checks.plugins.a.b[1] is set; valid: a finite number, text"),
        ({"a": {"b": {1: 2}}}, "key 1 in checks.plugins.a.b is no text"),
    ],
    ids=str,
)
def test_settings_of_plugins_are_plain_data(plugins: object, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        load_config({"checks": {"plugins": plugins}})
    assert said in one_line(error)


def test_settings_of_plugins_cannot_be_nested_forever(tmp_path: Path) -> None:
    levels = [f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}, *a{i - 1}]" for i in range(1, 40)]
    path = tmp_path / "c.yaml"
    inner = "".join(f"      {line}\n" for line in ["a0: &a0 [1]", *levels])
    path.write_text(f"checks:\n  plugins:\n    own:\n{inner}")
    with pytest.raises(ConfigError, match=r"nested too deeply; valid: 10 levels"):
        load_config(path)


def test_settings_of_plugins_are_part_of_the_hash() -> None:
    settings = {"keep-out": {"low_m": [0.1, 0.2, 0.3], "why": "shelf", "on": True, "more": None}}
    config = load_config({"checks": {"plugins": settings}})
    assert config.checks.plugins == settings
    assert load_config(config) == config
    assert config_hash(config) not in (
        config_hash(Config()),
        config_hash(load_config({"checks": {"plugins": {"keep-out": {"low_m": [0.1, 0.2, 0.4]}}}})),
    )


@pytest.mark.parametrize(("place", "name"), LEAVES, ids=str)
def test_every_leaf_refuses_nonsense(place: tuple[str, ...], name: str) -> None:
    for value in ({"a": {"b": {1}}}, float("nan")):
        with pytest.raises(ConfigError) as error:
            load_config(nest(place, {name: value}))
        assert ".".join((*place, name)) in one_line(error)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gripper: {length_m: 3}", "gripper.length_m is 3; valid: a number above 0 and at most 1"),
        ("gripper: {length_m: .inf}", "gripper.length_m is inf; valid: a finite number"),
        ("gripper: {length_m: long}", "gripper.length_m is 'long'"),
        ("gripper: {length_m: true}", "gripper.length_m is true"),
        ("gripper: {T_gripper_tcp: [1]}", "gripper.T_gripper_tcp is a list of 1; valid: a list of"),
        ("gripper:\n  length_m: 0.2\n  length_m: 0.3", "line 3, column 3: key 'length_m' is given"),
        ("gripper: [", "line 1, column 11:"),
        ("[1, 2]", "the whole is a list of 2; valid: a section with"),
        ("!!python/object/apply:os.system ['true']", "could not determine a constructor"),
        ("\x00", "not YAML"),
        ("a: &a [*a]", "unknown key 'a'"),
        ("gripper: &a {length_m: *a}", "gripper.length_m is"),
        ("[" * 5000, "not YAML"),
    ],
)
def test_mistakes_in_a_file(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as error:
        load_config(path)
    assert said in one_line(error) and str(path) in one_line(error)


def test_aliases_cannot_blow_up(tmp_path: Path) -> None:
    levels = [f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}, *a{i - 1}]" for i in range(1, 40)]
    path = tmp_path / "c.yaml"
    path.write_text("\n".join(["a0: &a0 [1]", *levels, "gripper: {T_gripper_tcp: *a39}"]))
    with pytest.raises(ConfigError):
        load_config(path)
    text = path.read_text()
    path.write_text(
        text.replace("gripper:", "T:").replace("a0: &a0", "gripper: {T_gripper_tcp: *b}")
    )
    with pytest.raises(ConfigError):
        load_config(path)


@pytest.mark.parametrize("path", ["nowhere.yaml", "."])
def test_unreadable_file(tmp_path: Path, path: str) -> None:
    with pytest.raises(ConfigError) as error:
        load_config(tmp_path / path)
    one_line(error)


def test_numbers_as_people_write_them(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("gripper: {length_m: 2e-1, max_opening_m: 1.0E-1, width_m: 1}")
    gripper = load_config(path).gripper
    assert (gripper.length_m, gripper.max_opening_m, gripper.width_m) == (0.2, 0.1, 1.0)


def test_hash_is_of_the_values() -> None:
    same = config_hash(load_config({"gripper": {"width_m": 1}}))
    assert same == config_hash(load_config({"gripper": {"width_m": 1.0}}))
    assert same == config_hash(Config(gripper=dataclasses.replace(Config().gripper, width_m=1)))
    assert same != config_hash(Config())
    assert len(same) == 16 and int(same, 16) >= 0


def test_config_built_by_hand_is_checked_too() -> None:
    class Sneaky(dict[str, object]):
        pass

    with pytest.raises(ConfigError):
        load_config(Sneaky(gripper={"length_m": -1}))


def test_gripper_file(tmp_path: Path) -> None:
    path = tmp_path / "g.yaml"
    path.write_text("max_opening_m: 0.08")
    assert load_gripper(path).max_opening_m == 0.08
    path.write_text("opening: 0.08")
    with pytest.raises(GripperError, match="did you mean opening_m"):
        load_gripper(path)
    path.write_text("max_opening_m: 0.5")
    with pytest.raises(GripperError, match="exceeds width_m"):
        load_gripper(path)


@dataclasses.dataclass(frozen=True)
class Inner:
    share: typing.Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.5


@dataclasses.dataclass(frozen=True)
class Outer:
    word: typing.Literal["euclidean", "split"] = "split"
    perhaps: Inner | None = None
    several: tuple[Inner, ...] = ()
    count: int | None = None


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"word": "split2"}, "word is 'split2'; valid: euclidean, split"),
        ({"perhaps": {"shore": 1}}, "unknown key 'shore' in perhaps; valid: share"),
        ({"several": [{}, {"shore": 1}]}, "unknown key 'shore' in several[1]"),
        ({"several": [{}, {"share": 1}]}, "several[1].share is 1; valid: a number at least 0 and"),
        ({"count": 1.5}, "count is 1.5; valid: a whole number or null"),
    ],
)
def test_unions_and_lists(data: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError) as error:
        build(Outer, data, "here", ConfigError)
    assert one_line(error).startswith(f"here: {said}")


def test_null_stays_null_where_it_may() -> None:
    assert build(Outer, {"perhaps": None}, "here", ConfigError).perhaps is None
    assert build(Outer, {"perhaps": {}}, "here", ConfigError).perhaps == Inner()


def test_describe() -> None:
    assert describe(typing.Annotated[int, msgspec.Meta(ge=1)]) == "a whole number at least 1"


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=8,
)


@given(st.sampled_from(LEAVES), plain)
def test_anything_gives_a_config_or_one_line(
    leaf: tuple[tuple[str, ...], str], value: object
) -> None:
    place, name = leaf
    try:
        config = load_config(nest(place, {name: value}))
    except BoxgraspError as error:
        assert "\n" not in str(error)
    else:
        assert load_config(config) == config
