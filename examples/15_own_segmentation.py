"""Another way to tell things apart is one function, and one line in a table of names.

In the package the function is a file in `perception/segmentation/` and the line stands in its
`__init__.py`. A segmentation of camera images hands over masks instead: 02_name_the_target.py.
"""

import numpy as np

from boxgrasp import GraspSelector
from boxgrasp.perception.segmentation import SEGMENTATIONS
from boxgrasp.perception.segmentation.euclidean import clusters_without_specks
from boxgrasp.perception.segmentation.protocol import Segments
from boxgrasp.simulate import build_scene, to_capture
from boxgrasp.simulate.demo import DEMO_SPEC


def by_color(seen, config):
    """Things that touch are two where one is red, green or blue and the other is not."""
    clusters = clusters_without_specks(seen.points, config.cluster_tolerance_m)
    if seen.colors is None:
        return Segments.all_objects(clusters)
    colors = np.nan_to_num(seen.colors)  # (K, 3), NaN where no camera saw the point
    strongest = np.argmax(colors, axis=1)
    vivid = colors.max(axis=1) > 2.0 * np.median(colors, axis=1)
    kept = clusters >= 0  # -1: noise, no thing
    pairs = np.column_stack((clusters, np.where(vivid, strongest, 3)))[kept]
    _, ids = np.unique(pairs, axis=0, return_inverse=True)
    clusters[kept] = ids.reshape(-1)
    return Segments.all_objects(clusters)


SEGMENTATIONS["by-color"] = f"{__name__}:by_color"  # module:function, found by its name

cube = {"name": "green_cube", "x": 0.85, "y": 0.0, "z": 0.0, "yaw": 0.0}
red, blue = cube | {"color": [200, 60, 50]}, cube | {"y": 0.06, "color": [60, 120, 200]}
touching = build_scene(DEMO_SPEC | {"target": red, "obstacles": [blue]})
view, _ = to_capture(touching, np.random.default_rng(0))
for name in ("euclidean", "split", "by-color"):
    selector = GraspSelector({"scene": {"segmentation": name}})
    sizes = [item.size_m.round(2).tolist() for item in selector.objects(view)]
    print(f"{name}: {len(sizes)} objects of {sizes} m; {selector.select(view)}")
