"""The operator asked a second time: how well it agrees with itself bounds who learns from it."""

from __future__ import annotations

import json

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.perception.target import Target
from boxgrasp.simulate.scenario import OPERATOR
from boxgrasp.teaching.rows import STAND_IN, RowConfig, scenario_of_row, selector, shown

SECOND = 1  # the generator's further number; the label of a row has none


def again_part(task: tuple[RowConfig, range]) -> bytes:
    """What the operator says of some scenarios on another day; a task of its own.

    Args:
        task: how rows are made, and the scenarios' numbers.

    Returns:
        JSON, a label each; null for a request for help.
    """
    config, numbers = task
    chosen = selector("given", config.lines, config.stride)
    said = []
    for number in numbers:
        scenario = scenario_of_row(config, number)
        capture, object_ids = scenario.capture(config.recipe.noise)
        analysis = chosen.analyze(capture, Target(mask=object_ids == scenario.scene.target_id))
        label = STAND_IN.label(shown(analysis, chosen), scenario.rng(OPERATOR, SECOND))
        said.append(label.label)
    return json.dumps(said).encode()


def read_again(parts: list[bytes]) -> Array:
    """The parts put together.

    Args:
        parts: of `again_part`.

    Returns:
        (N,) candidate indices, -1 for a request for help.
    """
    return np.array([(label or 0) - 1 for part in parts for label in json.loads(part)])
