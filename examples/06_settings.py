"""Settings by mapping or file; a misspelt one is refused, never ignored."""

from boxgrasp import BoxgraspError, GraspSelector, load_config
from boxgrasp.config import config_hash, dump_config
from boxgrasp.simulate import demo_capture

config = load_config({"candidates": {"lines": 5, "faces": ["front", "top-parallel"]}})
selection = GraspSelector(config).select(demo_capture())
print(len(selection.candidates), "candidates;", selection)
assert selection.config_hash == config_hash(config)

print(dump_config(config))
try:
    load_config({"candidates": {"linse": 5}})
except BoxgraspError as error:
    print("refused:", error)
