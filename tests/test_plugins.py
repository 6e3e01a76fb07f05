"""Rankers and checks of other packages, found by their entry points once they are installed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from boxgrasp import Capture, GraspSelector
from boxgrasp.cli import main
from boxgrasp.config import load_config
from boxgrasp.errors import ConfigError
from boxgrasp.ranking.ranker import ranker_names
from boxgrasp.selector import default_checks
from boxgrasp.simulate import demo_capture

MODULE = """
import numpy as np
from boxgrasp.grasps.checks import Check, CheckContext, CheckResult
from boxgrasp.ranking.ranker import Ranker, Ranking, RankingContext

class HighestLabel(Ranker):
    name = "highest-label"
    def rank(self, context: RankingContext) -> Ranking:
        count = len(context.candidates.label)
        return Ranking(np.arange(count)[::-1], np.full(count, 0.5))

class OverHeight(Check):
    name = "over_height"
    def __init__(self, height_m: float, margin_m: float = 0.0) -> None:
        if height_m < 0:
            raise ValueError("height_m is\\nbelow the floor")
        self.limit_m = height_m + margin_m
    def evaluate(self, context: CheckContext) -> CheckResult:
        return CheckResult.at_least(context.candidates.T_base_gripper[:, 2, 3], self.limit_m)

class Nothing:
    pass
"""
ENTRY_POINTS = """
[boxgrasp.rankers]
highest-label = tiny_rankers:HighestLabel
no-module = tiny_gone:HighestLabel
no-class = tiny_rankers:Lowest
no-ranker = tiny_rankers:Nothing
[boxgrasp.checks]
over-height = tiny_rankers:OverHeight
no-module = tiny_gone:OverHeight
no-check = tiny_rankers:Nothing
"""
TWIN = """
[boxgrasp.rankers]
highest-label = tiny_twin:HighestLabel
[boxgrasp.checks]
over-height = tiny_twin:OverHeight
"""
HEIGHT_M = 1.0


def installed(site: Path, name: str, entry_points: str) -> None:
    """A package of one module, installed by pip from a wheel made by hand."""
    info = f"{name}-1.0.dist-info"
    wheel = site.parent / f"{name}-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as file:
        file.writestr(f"{name}.py", MODULE)
        file.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        file.writestr(
            f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        file.writestr(f"{info}/entry_points.txt", entry_points)
        file.writestr(f"{info}/RECORD", "")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "install"]
    subprocess.run([*pip, "--no-deps", "--no-index", "--target", site, wheel], check=True)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plugins") / "site"
    installed(folder, "tiny_rankers", ENTRY_POINTS)
    return folder


@pytest.fixture
def there(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package can be imported."""
    monkeypatch.syspath_prepend(site)
    monkeypatch.delitem(sys.modules, "tiny_rankers", raising=False)


@pytest.fixture(scope="module")
def view() -> Capture:
    return demo_capture()


@pytest.fixture(scope="module")
def table(view: Capture, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("view") / "table.npz"
    names = ("depth", "intrinsics", "T_base_camera", "rgb", "target_pixel")
    np.savez(path, **{name: getattr(view, name) for name in names})
    return str(path)


def yaml(folder: Path, text: str) -> str:
    path = folder / "own.yaml"
    path.write_text(text, "utf-8")
    return str(path)


BOTH = f"ranker: highest-label\nchecks: {{plugins: {{over-height: {{height_m: {HEIGHT_M}}}}}}}"


@pytest.mark.usefixtures("there")
def test_a_yaml_file_names_a_packages_ranker_and_check(view: Capture, tmp_path: Path) -> None:
    found = GraspSelector(yaml(tmp_path, BOTH)).select(view)
    assert found.ranker == "highest-label"
    assert [candidate.rank for candidate in found.candidates] == list(range(15, 0, -1))
    plain = GraspSelector().select(view)
    for own, shipped in zip(found.candidates, plain.candidates, strict=True):
        assert list(own.checks) == [*shipped.checks, "over_height"]
        said = own.checks["over_height"]
        assert (said.value, said.limit) == (own.T_base_gripper[2, 3], HEIGHT_M)
        assert said.passed == (said.value >= HEIGHT_M)
        assert own.passed == (shipped.passed and said.passed)
    assert {candidate.checks["over_height"].passed for candidate in found.candidates} == {
        True,
        False,
    }


@pytest.mark.usefixtures("there")
def test_names_of_packages_are_among_the_valid_ones() -> None:
    assert "highest-label" in ranker_names()
    with pytest.raises(ConfigError, match=r"unknown ranker: oracle; valid: .*highest-label"):
        load_config({"ranker": "oracle"})
    assert [check.name for check in default_checks(load_config())][-1] != "over_height"


@pytest.mark.usefixtures("there")
def test_the_command_line_takes_both(
    table: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = yaml(tmp_path, BOTH)
    assert main(["select", "--json", table, "--config", config]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["ranker"] == "highest-label"
    assert all("over_height" in candidate["checks"] for candidate in answer["candidates"])
    assert main(["explain", table, "--config", config]) == 0
    shown = capsys.readouterr().out
    for candidate in answer["candidates"]:
        said = candidate["checks"]["over_height"]
        reason = f"over height: {100 * said['value']:.1f} cm, needs {100 * HEIGHT_M:.1f} cm"
        assert (reason in candidate["rejections"]) == (not said["passed"])
        assert said["passed"] or reason in shown
    assert main(["select", "--json", table, "--ranker", "highest-label"]) == 0
    assert json.loads(capsys.readouterr().out)["ranker"] == "highest-label"


def test_a_process_of_its_own_finds_them(site: Path, table: str, tmp_path: Path) -> None:
    words = ["-m", "boxgrasp", "select", "--json", table, "--config", yaml(tmp_path, BOTH)]
    done = subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(site)},
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["ranker"] == "highest-label"


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"ranker": "lowest-label"}, "unknown ranker: lowest-label; valid: clearance, single-spiral"),
    ({"ranker": "no-module"}, "tiny_gone:HighestLabel: ModuleNotFoundError: No module named"),
    ({"ranker": "no-class"}, "tiny_rankers:Lowest: AttributeError: module 'tiny_rankers' has no"),
    ({"ranker": "no-ranker"}, "Nothing is no ranker; valid: a class that inherits from Ranker"),
    (
        {"low-height": {}},
        "no entry point 'low-height' in the group boxgrasp.checks; valid: no-check",
    ),
    ({"no-module": {}}, "tiny_gone:OverHeight: ModuleNotFoundError: No module named 'tiny_gone'"),
    ({"no-check": {}}, "Nothing is no check; valid: an object with a name and evaluate(context)"),
    ({"over-height": {}}, "missing 1 required positional argument: 'height_m'"),
    ({"over-height": {"height": 1}}, "unexpected keyword argument 'height'"),
    ({"over-height": {"height_m": -1}}, "ValueError: height_m is below the floor"),
]


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize(("wrong", "said"), WRONG, ids=str)
def test_every_fault_is_one_line(
    wrong: dict[str, Any], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In Python, and from the command line, which reads the same from YAML."""
    settings = wrong if "ranker" in wrong else {"checks": {"plugins": wrong}}
    with pytest.raises(ConfigError) as error:
        GraspSelector(settings)
    assert said in str(error.value) and "\n" not in str(error.value)
    path = yaml(tmp_path, json.dumps(settings))  # JSON is YAML
    for words in (["select", "gone.npz"], ["objects", "gone.npz"]):
        assert main([*words, "--config", path]) == 2
        shown = capsys.readouterr()
        assert shown.out == "" and said in shown.err and shown.err.count("\n") == 1
        assert shown.err.startswith("boxgrasp: ")


@pytest.mark.usefixtures("there")
def test_a_name_that_two_packages_have_is_refused(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "site"
    installed(other, "tiny_twin", TWIN)
    monkeypatch.syspath_prepend(other)
    for settings, group, kind in (
        ({"ranker": "highest-label"}, "boxgrasp.rankers", "HighestLabel"),
        (
            {"checks": {"plugins": {"over-height": {"height_m": 1}}}},
            "boxgrasp.checks",
            "OverHeight",
        ),
    ):
        with pytest.raises(ConfigError) as error:
            GraspSelector(settings)
        assert str(error.value).endswith(
            f"of {group} is taken twice: tiny_rankers:{kind}, tiny_twin:{kind}; valid: once"
        )


@pytest.mark.usefixtures("there")
def test_two_checks_of_one_name_are_refused() -> None:
    from tiny_rankers import OverHeight  # type: ignore[import-not-found]

    with pytest.raises(ConfigError, match=r"over_height, over_height; valid: each name once"):
        GraspSelector(checks=[OverHeight(1.0), OverHeight(1.1)])
    with pytest.raises(ConfigError, match=r"OverHeight is a class; valid: .* OverHeight\(...\)"):
        GraspSelector(checks=[OverHeight])
