"""A trained SVM as an ONNX file: LIBSVM's arithmetic written out, in double precision."""

from __future__ import annotations

from typing import Any

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.errors import MissingExtraError, ModelError
from boxgrasp.onnx.session import DIGEST_KEY, RECORD_KEY, digest
from boxgrasp.ranking.onnx.record import Record, to_json

_OPSET, _IR = 17, 8  # read by every onnxruntime that the package allows
# A contest this even is even: what is left is rounding, and differs between machines. LIBSVM
# gives an even contest to the second of its two classes.
_EVEN = 1e-11


def to_onnx(svc: Any, record: Record) -> bytes:
    """The ONNX file of a trained SVM, its record inside.

    Input `features` (N, F) float32; outputs `label` (N,) int64, LIBSVM's vote with ties to the
    lowest class, and `decision` (N, K) float64, scikit-learn's one-against-rest decision_function
    (for two classes the same formula, a column each). The same model gives the same bytes.

    Args:
        svc: a scikit-learn SVC with RBF kernel.
        record: how it was made.

    Returns:
        The file.

    Raises:
        ModelError: another kernel, one class, or a record of another model.
        MissingExtraError: onnx is not installed.
    """
    _validate(svc, record)
    graph = _Graph()
    classes = np.asarray(svc.classes_, dtype=np.int64)
    first, second = np.triu_indices(len(classes), k=1)
    margins = _margins(graph, svc, first, second)
    firsts, seconds = np.eye(len(classes))[first], np.eye(len(classes))[second]
    _prediction(graph, margins, classes, firsts, seconds)
    _decision(graph, margins, firsts, seconds)
    return graph.file(len(record.features), len(classes), record)


def _validate(svc: Any, record: Record) -> None:
    if svc.kernel != "rbf" or not isinstance(svc.gamma, float):
        raise ModelError(f"SVC has kernel {svc.kernel!r}, gamma {svc.gamma!r}; valid: rbf, number")
    if svc.class_weight is not None or svc.break_ties:
        raise ModelError("SVC has class_weight or break_ties; valid: neither")
    told = (record.classes, len(record.features), record.C, record.gamma, record.support_vectors)
    found = (
        tuple(int(c) for c in svc.classes_),
        int(svc.shape_fit_[1]),
        float(svc.C),
        float(svc.gamma),
        len(svc.support_),
    )
    if told != found:
        names = ("classes", "number of features", "C", "gamma", "support_vectors")
        k = next(k for k in range(len(names)) if told[k] != found[k])
        raise ModelError(f"{names[k]} of the record is {told[k]}, of the SVC {found[k]}")


def _margins(graph: _Graph, svc: Any, first: Array, second: Array) -> str:
    """(N, P) LIBSVM's decision value of each pair of classes, positive for the first of the two."""
    vectors = np.ascontiguousarray(svc.support_vectors_, dtype=np.float64)
    count = len(svc.classes_)
    # For two classes scikit-learn shows LIBSVM's numbers with their signs turned.
    sign = -1.0 if count == 2 else 1.0
    dual, bias = sign * np.asarray(svc.dual_coef_), sign * np.asarray(svc.intercept_)
    x = graph.cast("features")
    small = vectors.astype(np.float32)
    exact = np.array_equal(small, vectors)  # features are float32, so it is half the size
    s = graph.cast(graph.number(small.T)) if exact else graph.number(vectors.T)
    norms = graph.number((vectors * vectors).sum(axis=1))
    own = graph.add("ReduceSum", graph.add("Mul", x, x), graph.number([1]), keepdims=1)
    cross = graph.add("Mul", graph.add("MatMul", x, s), graph.number(2.0))
    squared = graph.add("Relu", graph.add("Sub", graph.add("Add", own, norms), cross))
    kernel = graph.add("Exp", graph.add("Mul", squared, graph.number(-float(svc.gamma))))
    # Class by class: its vectors' sums for the contests with each other class.
    sizes = np.asarray(svc.n_support_, dtype=np.int64)
    parts = graph.split(kernel, sizes)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    sums = [
        graph.add("MatMul", part, graph.number(dual[:, starts[k] : starts[k + 1]].T))
        for k, part in enumerate(parts)
    ]
    every = graph.add("Concat", *sums, axis=1)
    # Row j - 1 of a class's coefficients is its contest with the later class j, row i with i.
    of_first = graph.add("Gather", every, graph.number(first * (count - 1) + second - 1), axis=1)
    of_second = graph.add("Gather", every, graph.number(second * (count - 1) + first), axis=1)
    margins = graph.add("Add", graph.add("Add", of_first, of_second), graph.number(bias))
    even = graph.add("Less", graph.add("Abs", margins), graph.number(_EVEN))
    return graph.add("Where", even, graph.number(0.0), margins)


def _prediction(
    graph: _Graph, margins: str, classes: Array, firsts: Floats, seconds: Floats
) -> None:
    """Votes as LIBSVM counts them: the first class needs a margin above 0."""
    won = graph.cast(graph.add("Greater", margins, graph.number(0.0)))
    lost = graph.add("Sub", graph.number(1.0), won)
    votes = _votes(graph, won, lost, firsts, seconds)
    best = graph.add("ArgMax", votes, axis=1, keepdims=0, select_last_index=0)
    graph.add("Gather", graph.number(classes), best, axis=0, output="label")


def _decision(graph: _Graph, margins: str, firsts: Floats, seconds: Floats) -> None:
    """scikit-learn's decision_function: the second class needs a margin below 0; then margins."""
    lost = graph.cast(graph.add("Less", margins, graph.number(0.0)))
    won = graph.add("Sub", graph.number(1.0), lost)
    votes = _votes(graph, won, lost, firsts, seconds)
    total = graph.add("MatMul", margins, graph.number(firsts - seconds))
    scale = graph.add("Mul", graph.add("Abs", total), graph.number(3.0))
    scale = graph.add("Add", scale, graph.number(3.0))
    graph.add("Add", votes, graph.add("Div", total, scale), output="decision")


def _votes(graph: _Graph, won: str, lost: str, firsts: Floats, seconds: Floats) -> str:
    """(N, K) contests won by each class."""
    for_first = graph.add("MatMul", won, graph.number(firsts))
    return graph.add("Add", for_first, graph.add("MatMul", lost, graph.number(seconds)))


class _Graph:
    """Nodes and numbers of an ONNX graph, named by their place."""

    def __init__(self) -> None:
        self._onnx = _library()
        self._nodes: list[Any] = []
        self._numbers: list[Any] = []

    def number(self, value: Any) -> str:
        """A constant: float32, float64 or int64."""
        array = np.asarray(value)
        if array.dtype.kind == "i":
            array = array.astype(np.int64)
        name = f"c{len(self._numbers)}"
        self._numbers.append(self._onnx.numpy_helper.from_array(np.array(array, order="C"), name))
        return name

    def add(self, operator: str, *inputs: str, output: str | None = None, **how: Any) -> str:
        """A node; its output's name."""
        name = output or f"v{len(self._nodes)}"
        self._nodes.append(self._onnx.helper.make_node(operator, inputs, [name], **how))
        return name

    def cast(self, value: str) -> str:
        """The same in double precision."""
        return self.add("Cast", value, to=self._onnx.TensorProto.DOUBLE)

    def split(self, value: str, sizes: Array) -> list[str]:
        """Columns in groups of those sizes."""
        names = [f"v{len(self._nodes)}_{k}" for k in range(len(sizes))]
        inputs = [value, self.number(sizes)]
        self._nodes.append(self._onnx.helper.make_node("Split", inputs, names, axis=1))
        return names

    def file(self, features: int, classes: int, record: Record) -> bytes:
        """The whole file."""
        helper, kinds = self._onnx.helper, self._onnx.TensorProto
        info = helper.make_tensor_value_info
        graph = helper.make_graph(
            self._nodes,
            record.name,
            [info("features", kinds.FLOAT, ["N", features])],
            [info("label", kinds.INT64, ["N"]), info("decision", kinds.DOUBLE, ["N", classes])],
            self._numbers,
        )
        model = helper.make_model(
            graph,
            ir_version=_IR,
            opset_imports=[helper.make_opsetid("", _OPSET)],
            producer_name="boxgrasp",
        )
        text = to_json(record)
        stored = model.graph.SerializeToString(deterministic=True)
        for key, value in ((RECORD_KEY, text), (DIGEST_KEY, digest(stored, text.encode()))):
            entry = model.metadata_props.add()
            entry.key, entry.value = key, value
        return bytes(model.SerializeToString(deterministic=True))


def _library() -> Any:
    try:
        import onnx
        import onnx.helper
        import onnx.numpy_helper
    except ImportError:
        raise MissingExtraError(
            "writing models needs onnx; install with: pip install 'boxgrasp[train]'"
        ) from None
    return onnx
