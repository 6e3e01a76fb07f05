"""The core runs without the optional parts, and importing it costs next to nothing."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

CORE = ("numpy", "numba", "llvmlite", "msgspec", "yaml", "_yaml", "PIL")
BLOCK = """
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in BLOCKED:
            raise ImportError(f"blocked: {name}")
sys.meta_path.insert(0, Block())
"""
OPTIONAL = (
    *("rosbags", "octomap", "pypcd4", "trimesh", "lz4", "ruamel", "matplotlib", "scipy"),
    *(
        "sklearn",
        "onnx",
        "jax",
        "optax",
        "open3d",
        "cv2",
        "torch",
        "mujoco",
        "rclpy",
        "pandas",
        "jsonschema",
    ),
)


def run(code: str, blocked: tuple[str, ...] = ()) -> str:
    """What a fresh interpreter prints for the code, with the named packages blocked."""
    text = f"BLOCKED = {blocked!r}\n{BLOCK}\n{textwrap.dedent(code)}"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_blocking_blocks() -> None:
    with pytest.raises(AssertionError, match="blocked: scipy"):
        run("import scipy.spatial", OPTIONAL)


def test_every_module_imports_without_the_optional_packages() -> None:
    code = """
    import importlib, pkgutil, boxgrasp
    names = [m.name for m in pkgutil.walk_packages(boxgrasp.__path__, "boxgrasp.")]
    names = [name for name in names if not name.startswith("boxgrasp.teaching.network.")]
    for name in names:
        importlib.import_module(name)
    print(len(names))
    """
    assert int(run(code, OPTIONAL)) > 20


def test_importing_the_package_imports_nothing_heavy() -> None:
    code = "import boxgrasp, boxgrasp.cli; print([m for m in HEAVY if m in sys.modules])"
    heavy = (*CORE, *OPTIONAL)
    assert run(f"HEAVY = {heavy!r}\n{code}").strip() == "[]"


def test_public_names() -> None:
    import boxgrasp

    for name in boxgrasp.__all__:
        assert getattr(boxgrasp, name) is not None
        assert name in dir(boxgrasp)
    with pytest.raises(AttributeError, match="no attribute 'Graspselector'"):
        _ = boxgrasp.Graspselector


def test_select_without_the_optional_packages() -> None:
    code = """
    from boxgrasp import GraspSelector
    from boxgrasp.simulate import demo_capture
    selection = GraspSelector().select(demo_capture())
    print(selection.status)
    """
    assert run(code, (*OPTIONAL, "PIL")).strip() in ("grasp", "ask")


def test_library_does_not_print_or_exit() -> None:
    source = Path(__file__).parent.parent / "src" / "boxgrasp"
    for path in source.rglob("*.py"):
        if "cli" in path.parts or path.name == "__main__.py":
            continue
        text = path.read_text("utf-8")
        assert "sys.exit" not in text and "print(" not in text, path
