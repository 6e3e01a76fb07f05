"""The training of the segmentation network: scenes cast as it goes, stopped and resumed at will."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import logging
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from numpy.typing import NDArray

from boxgrasp.errors import ConfigError, ModelError
from boxgrasp.execution import Store, Workers
from boxgrasp.onnx.session import record_of
from boxgrasp.perception.segmentation.network import FORMAT, INPUT_NAMES
from boxgrasp.teaching.network.examples import CELL_PX, SHAPE, Batch, BatchTask, draw_batch
from boxgrasp.teaching.network.files import to_onnx, weights_of
from boxgrasp.teaching.network.model import (
    CHANNELS,
    OFFSETS,
    Parameters,
    drawn_parameters,
    logits,
    losses,
)
from boxgrasp.version import __version__

MODEL, STATE = "network.onnx", "training.npz"

_log = logging.getLogger("boxgrasp.training")

_FOCAL_PX: Final = 262.5  # to which images are thinned: half of an Xtion's
_KEEP_EVERY_S: Final = 30.0
_SAY_EVERY_S: Final = 30.0
_ROUND: Final = 4096  # batches handed out at a time


@dataclass(frozen=True)
class TrainingParams:
    """How the network is trained.

    Attributes:
        minutes: of training, over all runs.
        batch: examples a step; 16 fill two cores.
        rate: highest learning rate of a fresh network. Adam's usual 1e-3, doubled: it was the
            largest of 1, 2 and 4e-3 that never diverged in the first 300 steps.
        rate_on: the same of one that goes on from given weights.
        warm_up: steps up to the highest rate; then it falls as a cosine to 0.
        decay: of weights, a step and rate.
        clip: most norm of a gradient.
        averaged: share of the mean of weights that a step keeps; the mean is what is written.
        seed: of scenes and weights.

    Raises:
        ConfigError: no time to train in, or a seed below 0.
    """

    minutes: float = 90.0
    batch: int = 16
    rate: float = 2e-3
    rate_on: float = 6e-4
    warm_up: int = 200
    decay: float = 1e-3
    clip: float = 1.0
    averaged: float = 0.998
    seed: int = 0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.minutes) and self.minutes > 0):
            raise ConfigError(f"minutes is {self.minutes:g}; valid: a number above 0")
        if self.seed < 0:
            raise ConfigError(f"seed is {self.seed}; valid: 0 or more")


@dataclass(frozen=True)
class _Progress:
    """What was done so far, over all runs.

    Attributes:
        steps: taken.
        seconds: spent.
        runs: started.
        start: SHA-256 and record of the file whose weights were the first ones, or None.
        loss: running means of the last ones.
    """

    steps: int = 0
    seconds: float = 0.0
    runs: int = 0
    start: dict[str, Any] | None = None
    loss: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class _State:
    """Everything that a step changes."""

    parameters: Parameters
    mean: Parameters
    optimizer: Any


def train_network(
    store: Store,
    workers: Workers,
    params: TrainingParams,
    *,
    resume: bool = False,
    start: bytes | None = None,
) -> dict[str, Any]:
    """Train until the minutes are spent, and write the network with its record.

    Args:
        store: where `network.onnx` and, from time to time, the state are written.
        workers: cast the scenes.
        params: how.
        resume: go on from the state in the store.
        start: bytes of a network's file whose weights are the first ones; None for random ones.

    Returns:
        The record.

    Raises:
        ModelError: nothing to resume, a state of another training, or weights of another network.
        StoreError: the place cannot be read or written.
        MissingExtraError: onnx is not installed.
    """
    state, done = _resumed(store, params) if resume else _fresh(store, params, start)
    done = replace(done, runs=done.runs + 1)
    step, before_s, begun = _step_of(params, done), done.seconds, time.monotonic()
    last_said, last_kept = begun, -np.inf  # the first step is kept: the place is taken
    _log.warning("training on %s; compiling first", jax.devices()[0].platform)
    for batch in _batches(workers, params, done.steps):
        if done.seconds >= params.minutes * 60:
            break
        state, loss = step(state, batch, _rate(done, params))
        now = time.monotonic()
        done = replace(
            done, steps=done.steps + 1, seconds=before_s + now - begun, loss=_running(done, loss)
        )
        if now - last_said > _SAY_EVERY_S:
            last_said = now
            _log.warning("%s", _line(done, params))
        if now - last_kept > _KEEP_EVERY_S:
            last_kept = now
            _keep(store, state, done, params)
    _keep(store, state, done, params)
    record = _record(done, params)
    store.write(MODEL, to_onnx(state.mean, record))
    return record


def _batches(workers: Workers, params: TrainingParams, first: int) -> Iterator[Batch]:
    """Batches without end, cast a few ahead."""
    while True:
        numbers = range(first, first + _ROUND)
        tasks = [BatchTask(params.seed, number, params.batch) for number in numbers]
        with contextlib.closing(workers.run(draw_batch, tasks)) as cast:
            for _, batch in cast:
                yield batch
        first += _ROUND


def _rate(done: _Progress, params: TrainingParams) -> float:
    """The learning rate: a short rise, then a cosine to 0 over the minutes."""
    highest = params.rate if done.start is None else params.rate_on
    share = min(done.seconds / (params.minutes * 60), 1.0)
    risen = min(1.0, (done.steps + 1) / params.warm_up)
    return float(highest * risen * 0.5 * (1.0 + np.cos(np.pi * share)))


def _fresh(store: Store, params: TrainingParams, start: bytes | None) -> tuple[_State, _Progress]:
    if store.exists(STATE):
        raise ModelError(
            f"{store}/{STATE}: a training is there already; valid: --resume, or another place"
        )
    if start is None:
        parameters, first = drawn_parameters(np.random.default_rng(params.seed)), None
    else:
        parameters = weights_of(start)
        first = {
            "sha256": hashlib.sha256(start).hexdigest(),
            "record": json.loads(record_of(start)[0]),
        }
    optimizer = _optimizer(params).init(parameters)
    return _State(parameters, parameters, optimizer), _Progress(start=first)


def _optimizer(params: TrainingParams) -> optax.GradientTransformation:
    """Adam with decoupled decay (Loshchilov and Hutter 2019); the rate is applied by the step."""
    return optax.chain(
        optax.clip_by_global_norm(params.clip),
        optax.scale_by_adam(),
        optax.add_decayed_weights(params.decay),
    )


def _step_of(
    params: TrainingParams, done: _Progress
) -> Callable[[_State, Batch, float], tuple[_State, Array]]:
    optimizer = _optimizer(params)

    def loss_of(parameters: Parameters, inputs: Array, things: Array, told: Array) -> Any:
        each = losses(logits(parameters, inputs.astype(jnp.float32)), things, told)
        return jnp.mean(each), each

    @jax.jit
    def update(
        parameters: Parameters, mean: Parameters, held: Any, batch: Any, rate: Any, keep: Any
    ) -> Any:
        (_, each), gradient = jax.value_and_grad(loss_of, has_aux=True)(parameters, *batch)
        change, held = optimizer.update(gradient, held, parameters)
        parameters = jax.tree.map(lambda p, c: p - rate * c, parameters, change)
        mean = jax.tree.map(lambda m, p: keep * m + (1 - keep) * p, mean, parameters)
        return parameters, mean, held, each

    steps = done.steps

    def step(state: _State, batch: Batch, rate: float) -> tuple[_State, Array]:
        nonlocal steps
        steps += 1
        keep = min(params.averaged, steps / (steps + 10))
        arrays = batch.inputs, batch.things, batch.told
        *parts, each = update(
            state.parameters, state.mean, state.optimizer, arrays, np.float32(rate),
            np.float32(keep),
        )  # fmt: skip
        return _State(*parts), each

    return step


def _running(done: _Progress, loss: Array) -> tuple[float, ...]:
    now = np.asarray(loss, dtype=np.float64)
    keep = 0.98 if done.loss else 0.0
    mixed = keep * np.array(done.loss or now) + (1 - keep) * now
    return tuple(float(value) for value in mixed)


def _line(done: _Progress, params: TrainingParams) -> str:
    near = max(done.loss[1:3], default=0.0)
    far = max(done.loss[3:], default=0.0)
    return (
        f"minute {done.seconds / 60:.1f} of {params.minutes:g}: "
        f"{done.steps * params.batch} examples, loss of things {done.loss[0]:.4f}, "
        f"of pairs next to each other {near:.4f}, farther {far:.4f}"
    )


def _leaves(state: _State) -> list[NDArray[Any]]:
    tree = (state.parameters, state.mean, state.optimizer)
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]


def _keep(store: Store, state: _State, done: _Progress, params: TrainingParams) -> None:
    told = json.dumps({"progress": asdict(done), "params": asdict(params)})
    named: dict[str, Any] = {f"a{k}": leaf for k, leaf in enumerate(_leaves(state))}
    buffer = io.BytesIO()
    np.savez(buffer, told=np.frombuffer(told.encode(), dtype=np.uint8), **named)
    store.write(STATE, buffer.getvalue())


def _resumed(store: Store, params: TrainingParams) -> tuple[_State, _Progress]:
    if not store.exists(STATE):
        raise ModelError(f"{store}/{STATE}: nothing to resume; valid: a folder of a training")
    drawn = drawn_parameters(np.random.default_rng(0))
    empty = (drawn, drawn, _optimizer(params).init(drawn))
    expected, shape = jax.tree.flatten(empty)
    try:
        with np.load(io.BytesIO(store.read(STATE)), allow_pickle=False) as file:
            told = json.loads(bytes(file["told"]))
            leaves = [file[f"a{k}"] for k in range(len(expected))]
        held = told["params"]
        progress = told["progress"]
        done = _Progress(**{**progress, "loss": tuple(progress["loss"])})
    except Exception as error:  # a damaged file may fail in many ways
        said = " ".join(str(error).split())
        raise ModelError(f"{store}/{STATE}: damaged: {said[:200]}") from None
    if any(a.shape != b.shape or a.dtype != b.dtype for a, b in zip(leaves, expected, strict=True)):
        raise ModelError(f"{store}/{STATE}: of another network")
    other = {k for k, v in asdict(params).items() if k != "minutes" and held.get(k) != v}
    if other:
        raise ModelError(
            f"{store}/{STATE}: trained with another {', '.join(sorted(other))}; valid: the same"
        )
    parameters, mean, optimizer = jax.tree.unflatten(shape, [jnp.asarray(leaf) for leaf in leaves])
    return _State(parameters, mean, optimizer), done


def _record(done: _Progress, params: TrainingParams) -> dict[str, Any]:
    device = jax.devices()[0]
    return {
        "kind": "segmentation",
        "format": FORMAT,
        "focal_px": _FOCAL_PX,
        "cell_px": CELL_PX,
        "offsets": OFFSETS,
        "inputs": INPUT_NAMES,
        "network": {"kind": "U-Net", "channels": CHANNELS},
        "scenes": {
            "examples": done.steps * params.batch,
            "shape_px": SHAPE,
            "drawn_by": "boxgrasp.simulate.ugly, boxgrasp.simulate.sensors",
            "sensors": "structured light, active stereo, time of flight; no real image",
        },
        "training": {
            **asdict(params),
            "steps": done.steps,
            "seconds": round(done.seconds),
            "runs": done.runs,
            "from": done.start,
            "loss": [round(value, 5) for value in done.loss],
            "device": f"{device.platform} {device.device_kind}",
            "machine": platform.machine(),
        },
        "versions": {
            "boxgrasp": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in ("jax", "numpy", "numba", "onnx", "optax")},
        },
    }
