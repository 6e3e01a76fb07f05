"""The labeling page under a scripted operator: `python benchmarks/label_page.py [SCENES]`.

A real Chromium, driven by Playwright, labels scenes that are drawn on the fly, 640 x 480 pixels and
50,000 points each, through the page's own keys. Told are: from the key that saves until the page's
state shows the next scene, and until the cloud's points have come to a browser's side (a second
WebSocket of the same view), with an operator who looks for LOOKS_S at each; then the memory of the
server and of the page over SCENES scenes labeled as fast as they come (default: 800).

The browser draws nothing here, since a software renderer's time says nothing of a tablet's: with
--draw it does. The page's memory is told with --draw alone: viser's client keeps what it is sent
until it has drawn it. Needs the extra `label`, Playwright and a Chromium.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from label_browser import Labeling, Server, chromium

LOOKS_S = 1.5  # at each scene; people took 4 s and more
WARM_UP = 50  # scenes
CLOUD_BYTES = 500_000  # a message as large is the cloud
# Both moments are of the page's own clock: Playwright's way to it is not counted.
WATCH = """
() => {
  window.saved = null; window.shownAt = null;
  const before = document.body.dataset.serial;
  const note = () => { window.saved ??= performance.now(); };
  document.addEventListener("keydown", note, { capture: true, once: true });
  new MutationObserver((_, me) => {
    if (document.body.dataset.serial === before) return;
    window.shownAt = performance.now();
    me.disconnect();
  }).observe(document.body, { attributes: true });
}
"""


class ViewListener:
    """A second browser's side of the view, which notes when a cloud has come."""

    def __init__(self, url: str, session: str) -> None:
        self.clouds: list[float] = []
        self._url = f"{url.replace('http', 'ws')}view/{session}"
        threading.Thread(target=lambda: asyncio.run(self._listen()), daemon=True).start()

    async def _listen(self) -> None:
        import viser
        from websockets.asyncio.client import connect
        from websockets.exceptions import ConnectionClosedError

        name: Any = f"viser-v{viser.__version__}"
        with contextlib.suppress(ConnectionClosedError):  # the server ends at last
            async with connect(self._url, subprotocols=[name], max_size=None) as socket:
                async for message in socket:
                    if len(message) > CLOUD_BYTES:
                        self.clouds.append(time.perf_counter())

    def after(self, moment: float) -> float:
        """Seconds from a moment until the next cloud had come; waits for it."""
        while not (found := [at for at in self.clouds if at > moment]):
            time.sleep(0.002)
        return found[0] - moment


def latencies(page: Labeling, url: str, scenes: int) -> None:
    """From saving to the next scene, of an operator who looks at each."""
    listener = ViewListener(url, page.state["session"])
    time.sleep(3)
    shown, came = [], []
    for _ in range(scenes):
        time.sleep(LOOKS_S)
        page.press("2", "2")
        time.sleep(0.2)
        page.page.evaluate(WATCH)
        moment = time.perf_counter()
        page.press("Enter")
        page.page.wait_for_function("() => window.shownAt !== null", polling=10)
        shown.append(page.page.evaluate("shownAt - saved"))
        came.append(1000 * listener.after(moment))
    for what, ms in (("the page shows the next scene", shown), ("its cloud has come", came)):
        low, middle, high = np.percentile(ms, (5, 50, 95))
        print(f"{what}: median {middle:.0f} ms (5 to 95 %: {low:.0f} to {high:.0f})", flush=True)


def memory(page: Labeling, server: Server, scenes: int, *, drawn: bool) -> None:
    """Of the server and of the page, over scenes labeled as fast as they come."""
    start: dict[str, float] = {}
    for done in range(1, scenes + 1):
        page.save("2", "2")
        if done in (WARM_UP, scenes) or done % 100 == 0:
            held = {"server": resident_mb(server.pid), **({"page": page_mb(page)} if drawn else {})}
            start = start or held
            told = [
                f"{k} {mb:.0f} MB ({100 * (mb / start[k] - 1):+.0f} %)" for k, mb in held.items()
            ]
            print(f"{done} scenes: {', '.join(told)}", flush=True)


def resident_mb(pid: int) -> float:
    """A process's memory."""
    line = next(
        line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if "VmRSS" in line
    )
    return float(line.split()[1]) / 1024


def page_mb(page: Labeling) -> float:
    """The page's own objects, after they were collected."""
    client = page.context.new_cdp_session(page.page)
    client.send("HeapProfiler.collectGarbage")
    used = client.send("Runtime.getHeapUsage")["usedSize"]
    client.detach()
    return float(used) / 2**20


def main() -> None:
    """Label, and tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", type=int, nargs="?", default=800)
    parser.add_argument("--timed", type=int, default=60, help="scenes that are timed (default: 60)")
    parser.add_argument("--draw", action="store_true", help="let a software renderer draw")
    args = parser.parse_args()
    count = args.scenes + args.timed + 10
    with tempfile.TemporaryDirectory() as folder:
        words = ("simulate", "--count", str(count), "--database", f"{folder}/labels.sqlite")
        with Server(*words, "--again-share", "0") as server, chromium(drawing=args.draw) as browser:
            page = Labeling(browser, server.url, "Ada")
            latencies(page, server.url, args.timed)
            memory(page, server, args.scenes, drawn=args.draw)


if __name__ == "__main__":
    main()
