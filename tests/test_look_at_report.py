"""tools/look_at_report.py: says in one line what it lacks, and finds what a browser shows."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parent.parent / "tools" / "look_at_report.py"
PIXEL = (
    "data:image/svg+xml,"
    "%3Csvg xmlns='http://www.w3.org/2000/svg' width='{0}' height='20'%3E%3C/svg%3E"
)
WIDE = f'<img src="{PIXEL.format(2000)}">'


def look(path, *words, without=""):
    """Its exit status and output, a package hidden from it."""
    hide = f"import sys, runpy; sys.modules[{without!r}] = None; " if without else ""
    code = f"{hide}import sys, runpy; sys.argv = {[str(TOOL), str(path), *map(str, words)]!r}; "
    code += f"runpy.run_path({str(TOOL)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout


def test_what_it_lacks_is_said_in_one_line(tmp_path):
    status, said = look(tmp_path / "none.html")
    assert status == 2 and said.count("\n") == 1 and "no file" in said
    (tmp_path / "page.html").write_text("<p>words</p>")
    status, said = look(tmp_path / "page.html", without="playwright.sync_api")
    assert status == 3 and said.count("\n") == 1 and "pip install playwright" in said


@pytest.mark.parametrize(
    ("body", "found"),
    [
        ('<section id="a"><p>words</p></section>', []),
        (f'<section id="a">{WIDE}</section>', ["scrolls sideways", "img in a ends"]),
        (f'<section id="a"><div style="overflow-x:auto">{WIDE}</div></section>', []),
        ('<section id="a"><img src="data:image/png;base64,AAAA" width=9></section>', ["is broken"]),
        (WIDE.replace("<img", "<img style='width:300px'"), ["is shrunk to 15 %"]),
        (f"<a href='#'>{WIDE.replace('<img', '<img style=width:300px')}</a>", []),
    ],
    ids=["right", "wide", "scrolls", "broken", "shrunk", "openable"],
)
def test_it_finds_what_is_wrong(tmp_path, body, found):
    pytest.importorskip("playwright", reason="a tool of its own")
    if not shutil.which("chromium"):
        pytest.skip("no Chromium")
    page = tmp_path / "page.html"
    page.write_text(f"<!doctype html><body style='margin:0'>{body}")
    status, said = look(page, tmp_path / "shots")
    assert status == (1 if found else 0), said
    for words in found:
        assert f"at 390 px {words}" in said or words in said
    assert (tmp_path / "shots" / "report.pdf").stat().st_size > 500
    assert (tmp_path / "shots" / "390-top.png").exists()
