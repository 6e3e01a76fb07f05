"""Training of the segmentation network: resumed after a kill, recorded, written as it computes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax")
optax = pytest.importorskip("optax")
pytest.importorskip("onnxruntime")
onnx = pytest.importorskip("onnx")

from boxgrasp import GraspSelector  # noqa: E402
from boxgrasp.errors import ModelError  # noqa: E402
from boxgrasp.execution import Store, local_workers  # noqa: E402
from boxgrasp.onnx.session import record_of  # noqa: E402
from boxgrasp.perception.segmentation.network import WEIGHTS, read_network  # noqa: E402
from boxgrasp.teaching.network.examples import BatchTask, draw_batch  # noqa: E402
from boxgrasp.teaching.network.files import to_onnx, weights_of  # noqa: E402
from boxgrasp.teaching.network.model import (  # noqa: E402
    OFFSETS,
    drawn_parameters,
    logits,
    losses,
)
from boxgrasp.teaching.network.training import (  # noqa: E402
    MODEL,
    STATE,
    TrainingParams,
    train_network,
)

SHORT = TrainingParams(minutes=0.02, batch=2, seed=5)
RECORD = {"kind": "segmentation", "format": 1, "focal_px": 262.5, "cell_px": 2, "offsets": OFFSETS}


def command(out: Path, *more: str) -> list[str]:
    words = ("train", "segmentation", str(out), "--processes", "1", *more)
    return [sys.executable, "-m", "boxgrasp", *words]


def test_the_file_computes_what_the_training_does() -> None:
    parameters = drawn_parameters(np.random.default_rng(2))
    network = read_network(to_onnx(parameters, RECORD))
    x = np.random.default_rng(3).normal(size=(7, 48, 80)).astype(np.float32)
    said = np.asarray(logits(parameters, x.transpose(1, 2, 0)[None]))[0].transpose(2, 0, 1)
    expected = 1 / (1 + np.exp(-said))
    np.testing.assert_allclose(network.probabilities(x), expected, atol=2e-5)


def test_weights_come_back_from_a_file_as_they_were() -> None:
    parameters = drawn_parameters(np.random.default_rng(2))
    for (a, b), (c, d) in zip(parameters, weights_of(to_onnx(parameters, RECORD)), strict=True):
        np.testing.assert_array_equal(a, c)
        np.testing.assert_array_equal(b, d)


def test_the_loss_is_that_of_the_plain_rule() -> None:
    rng = np.random.default_rng(0)
    said = rng.normal(size=(2, 14, 16, 1 + len(OFFSETS))).astype(np.float32)
    things = rng.integers(0, 3, (2, 14, 16))
    told = rng.random((2, 14, 16)) < 0.8
    found = np.asarray(losses(said, things, told))
    for k, (dv, du) in enumerate(((0, 0), *OFFSETS)):
        total = weights = 0.0
        for b, v, u in np.ndindex(2, 14, 16):
            if not (0 <= v + dv < 14 and 0 <= u + du < 16):
                continue
            here, there = things[b, v, u], things[b, v + dv, u + du]
            true, weight = here == there, 1.0 if here == there else 3.0
            if k == 0:
                true, weight, there = here > 0, 1.0, 1
            if not (told[b, v, u] and told[b, v + dv, u + du] and (here > 0 or there > 0)):
                continue
            chance = 1 / (1 + np.exp(-said[b, v, u, k]))
            total -= weight * np.log(chance if true else 1 - chance)
            weights += weight
        assert found[k] == pytest.approx(total / weights, rel=1e-4)


def test_a_batch_is_drawn_by_seed_and_number() -> None:
    one, two = draw_batch(BatchTask(1, 2, 3)), draw_batch(BatchTask(1, 2, 3))
    other = draw_batch(BatchTask(1, 3, 3))
    np.testing.assert_array_equal(one.inputs, two.inputs)
    np.testing.assert_array_equal(one.things, two.things)
    assert not np.array_equal(one.things, other.things)
    assert one.inputs.shape == (3, 144, 192, 7) and one.things.shape == (3, 72, 96)
    assert np.isfinite(one.inputs.astype(np.float32)).all() and one.told.any()


def test_the_network_learns_a_batch_by_heart() -> None:
    batch = draw_batch(BatchTask(0, 0, 2))
    parameters, optimizer = drawn_parameters(np.random.default_rng(1)), optax.adam(3e-3)
    held, inputs = optimizer.init(parameters), batch.inputs.astype(np.float32)

    @jax.jit
    def step(parameters: Any, held: Any) -> Any:
        def loss(of: Any) -> Any:
            return losses(logits(of, inputs), batch.things, batch.told).mean()

        value, gradient = jax.value_and_grad(loss)(parameters)
        change, held = optimizer.update(gradient, held)
        return optax.apply_updates(parameters, change), held, value

    found = []
    for _ in range(40):
        parameters, held, value = step(parameters, held)
        found.append(float(value))
    assert np.isfinite(found).all() and found[-1] < 0.5 * found[0]


@pytest.mark.slow
def test_killed_and_resumed_it_gives_a_network_with_a_complete_record(tmp_path: Path) -> None:
    out = tmp_path / "net"
    first = subprocess.Popen(command(out, "--minutes", "30"), stderr=subprocess.DEVNULL)
    until = time.monotonic() + 240
    while not (out / STATE).exists():
        assert time.monotonic() < until and first.poll() is None
        time.sleep(0.2)
    first.send_signal(signal.SIGKILL)
    first.wait()
    assert not (out / MODEL).exists()
    again = subprocess.run(command(out, "--minutes", "30"), capture_output=True, text=True)
    assert again.returncode == 2 and "--resume" in again.stderr.splitlines()[-1]
    done = subprocess.run(
        command(out, "--minutes", "0.01", "--resume"), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    network = read_network((out / MODEL).read_bytes())
    assert network.offsets == OFFSETS
    text, whole = record_of((out / MODEL).read_bytes())
    record = json.loads(text)
    assert whole and record["training"]["runs"] == 2
    assert record["scenes"]["examples"] >= 16
    assert set(record["versions"]) >= {"boxgrasp", "jax", "numpy", "onnx", "optax", "python"}
    assert {"seed", "minutes", "rate", "device", "from"} <= set(record["training"])


def test_going_on_from_a_network_is_recorded(tmp_path: Path) -> None:
    with local_workers(1) as workers:
        record = train_network(Store(tmp_path), workers, SHORT, start=WEIGHTS.read_bytes())
        before = record["training"]["from"]
        assert len(before["sha256"]) == 64 and before["record"]["kind"] == "segmentation"
        assert record["scenes"]["examples"] == record["training"]["steps"] * 2
        before, after = (weights_of(p.read_bytes()) for p in (WEIGHTS, tmp_path / MODEL))
        off = [float(np.abs(a[0] - b[0]).max()) for a, b in zip(before, after, strict=True)]
        assert 0 < max(off) < 0.05
        with pytest.raises(ModelError, match="seed; valid: the same"):
            other = TrainingParams(minutes=1, batch=2, seed=6)
            train_network(Store(tmp_path), workers, other, resume=True)


def test_what_cannot_be_resumed_is_told_in_one_line(tmp_path: Path) -> None:
    with local_workers(1) as workers:
        for content, said in (
            (None, "nothing to resume"),
            (b"", "damaged"),
            (b"PK\x03\x04 broken", "damaged"),
        ):
            if content is not None:
                (tmp_path / STATE).write_bytes(content)
            with pytest.raises(ModelError, match=said) as caught:
                train_network(Store(tmp_path), workers, SHORT, resume=True)
            assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "No such file"), (b"nonsense", "not an ONNX file"), (b"", "not an ONNX file")],
)
def test_a_wrong_network_in_the_settings_gives_one_line(
    content: bytes | None, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "net.onnx"
    if content is not None:
        path.write_bytes(content)
    from helpers import drawn, seen

    config = {"scene": {"segmentation": "network", "network": str(path)}}
    with pytest.raises(ModelError, match=said) as caught:
        GraspSelector(config).select(seen(drawn(3)))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_options_of_the_network_are_refused_for_the_svms(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "boxgrasp", "train", str(tmp_path), "out", "--resume"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 2 and "train segmentation" in done.stderr
