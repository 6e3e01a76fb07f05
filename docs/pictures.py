"""Draw the pictures of the README and these pages again. `python docs/pictures.py`."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from boxgrasp import GraspSelector
from boxgrasp.config import load_gripper
from boxgrasp.draw import draw_gripper, draw_objects, draw_selection
from boxgrasp.draw.palette import CATEGORY, GRIPPER, HELD, OBSTACLE
from boxgrasp.simulate import demo_capture

IMAGES = Path(__file__).parent / "images"
WIDTH = {"demo": 1100, "objects": 760, "hand": 1000}


def drawn() -> dict[str, Image.Image]:
    """The demo's answer, its numbered objects and a hand, made smaller, their colors kept."""
    view, selector = demo_capture(), GraspSelector()
    found = {
        "demo": draw_selection(view, selector.select(view)),
        "objects": draw_objects(view, selector.scene(view)),
        "hand": draw_gripper(load_gripper("robotiq-2f-85")),
    }
    return {name: paletted(smaller(picture, WIDTH[name])) for name, picture in found.items()}


def smaller(image: Image.Image, width: int) -> Image.Image:
    """The picture at another width."""
    height = round(image.height * width / image.width)
    return image.convert("RGB").resize((width, height), Image.Resampling.LANCZOS)


def paletted(image: Image.Image) -> Image.Image:
    """The picture in 256 colors, those that mean something kept as they are."""
    fixed = [*CATEGORY.values(), GRIPPER, OBSTACLE, HELD]
    own = image.quantize(256 - len(fixed), Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    colors = (own.getpalette() or [])[: 3 * (256 - len(fixed))]
    palette = Image.new("P", (1, 1))
    palette.putpalette([*(value for color in fixed for value in color), *colors])
    return image.quantize(palette=palette, dither=Image.Dither.NONE)


if __name__ == "__main__":
    for name, picture in drawn().items():
        picture.save(IMAGES / f"{name}.png", optimize=True)
