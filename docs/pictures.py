"""Draw the pictures of the README and these pages anew. `python docs/pictures.py`."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from boxgrasp import GraspSelector
from boxgrasp.draw import draw_objects, draw_selection
from boxgrasp.simulate import demo_capture

IMAGES = Path(__file__).parent / "images"
WIDTH = {"demo": 1100, "objects": 760}


def main() -> None:
    """The demo's answer and its numbered objects, made smaller, their colors kept."""
    view, selector = demo_capture(), GraspSelector()
    pictures = {
        "demo": draw_selection(view, selector.select(view)),
        "objects": draw_objects(view, selector.objects(view)),
    }
    for name, picture in pictures.items():
        height = round(picture.height * WIDTH[name] / picture.width)
        small = picture.convert("RGB").resize((WIDTH[name], height), Image.Resampling.LANCZOS)
        # Octree keeps the categories' colors, which a median cut over a brown scene loses.
        paletted = small.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        paletted.save(IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
