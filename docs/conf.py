"""Sphinx settings; `make docs` builds with warnings as errors."""

import dataclasses
import re
import typing
from pathlib import Path

import myst_parser
from sphinx.util.inspect import TypeAliasForwardRef

import boxgrasp
from boxgrasp.config import Config
from boxgrasp.perception.segmentation import SEGMENTATIONS
from boxgrasp.strict import attributes_of, describe

project = "boxgrasp"
author = "boxgrasp contributors"
project_copyright = "boxgrasp contributors, Apache-2.0"
version = release = boxgrasp.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
# The last one for Python 3.10 warns of a name after `file.md#`, and links it all the same.
if int(myst_parser.__version__.split(".")[0]) < 5:
    suppress_warnings = ["myst.xref_missing"]
autodoc_typehints = "description"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Bools", "Floats", "Points")}
autodoc_member_order = "bysource"
autodoc_class_signature = "separated"
html_theme = "furo"
html_title = "boxgrasp"
html_show_sphinx = False
napoleon_numpy_docstring = False

# Settings whose type says less than a reader needs.
NAMED = {
    "ranker": "a ranker's name",
    "plugins": "a section a check",
    "faces": "a list of faces' names",
    "segmentation": ", ".join(SEGMENTATIONS),
}

# A union with an alias is spelled by the alias's repr, which names Sphinx's own class otherwise.
TypeAliasForwardRef.__repr__ = lambda self: self.name


def settings_of(kind, place=()):
    """A table of each section's settings, their defaults and ranges, from the code itself."""
    hints = typing.get_type_hints(kind, include_extras=True)
    default = kind()
    head, said = attributes_of(kind)
    own = [f.name for f in dataclasses.fields(kind) if not dataclasses.is_dataclass(hints[f.name])]
    lines = [f"### `{'.'.join(place)}`" if place else "### At the top", ""]
    if place:
        lines += [head, ""]
    lines += ["| setting | default | valid | meaning |", "|---|---|---|---|"]
    for name in own:
        value = getattr(default, name)
        value = "the fingertips" if name == "T_gripper_tcp" else value
        value = ", ".join(map(str, value)) if isinstance(value, tuple) else value
        value = "none" if value == {} else "null" if value is None else value
        valid = NAMED.get(name) or describe(hints[name])
        lines.append(f"| `{name}` | {value} | {valid} | {said.get(name, '')} |")
    lines.append("")
    for name, hint in hints.items():
        if dataclasses.is_dataclass(hint):
            lines += settings_of(hint, (*place, name))
    return lines


built = Path(__file__).parent / "_build"
built.mkdir(exist_ok=True)
(built / "settings.md").write_text("\n".join(settings_of(Config)), "utf-8")


def escape(app, what, name, obj, options, lines):
    """Docstrings are plain text with `code`; what else reST would read as markup is escaped."""
    for k, line in enumerate(lines):
        pieces = line.split("`")
        pieces[::2] = [re.sub(r"([|*\\])|(?<=\w)_(?!\w)", r"\\\g<0>", text) for text in pieces[::2]]
        lines[k] = "``".join(pieces) if len(pieces) % 2 else line


def setup(app):
    app.connect("autodoc-process-docstring", escape, priority=400)  # before napoleon
